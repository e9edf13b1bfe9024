"""What needs no drive: friction laws (Sec. 2.3, Fig. 2.9)."""

from __future__ import annotations

from ssmr.models.coulomb import CoulombParameters
from ssmr.models.friction import arctangent_friction, hyperviscous_friction, implied_steepness
from ssmr.models.linear import LinearParameters
from validation.replicate.chapters import Findings, Section, Task
from validation.thesis import published
from validation.thesis.verdicts import Pair


def _laws(task: Task) -> Findings:
    """Find how steep an arctangent the fitted coefficients imply."""
    dry, viscous, drawn = CoulombParameters(), LinearParameters(), published.value("text", "k_s_figure_2_9")
    steepness = {"k_s of K_u and u_x": (viscous.k_u, dry.u_x), "k_s of K_y and mu_c": (viscous.k_y, dry.mu_c)}
    rows = {name: {"value": Pair(drawn, implied_steepness(*numbers), "words", "s/m")} for name, numbers in steepness.items()}
    words = {
        "drawn": drawn,
        "share": arctangent_friction(1.0, 1.0, 0.25, drawn),
        "passes": 1e3 / hyperviscous_friction(1.0, 1.0, 1.0, drawn),
    }
    return Findings({"Fig. 2.9": rows}, words)


FRICTION_SECTION = Section("friction", ("Fig. 2.9",), _laws)
"""The section that drives nothing."""
