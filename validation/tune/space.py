"""Gains of each controller that a tuning may move, with their bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ssmr.search.space import Parameter, ParameterSpace

_PUBLISHED: Mapping[str, Mapping[str, tuple[float, float, str]]] = {
    "pid": {
        **{f"k_p_{e}": (0.0, 6.0, u) for e, u in (("rho", "1/s"), ("y", "rad/(m s)"), ("alpha", "1/s"))},
        **{f"k_i_{e}": (0.0, 2.0, u) for e, u in (("rho", "1/s2"), ("y", "rad/(m s2)"), ("alpha", "1/s2"))},
        **{f"k_{b}_{e}": (0.0, 2.0, u) for e in ("u", "w") for b, u in (("p", "1"), ("i", "1/s"))},
    },
    "lqr": {
        "q_x": (2.0, 5.0, "1/m2"),
        "q_v": (0.0, 0.05, "s2/m2"),
        "q_yaw": (5.0, 15.0, "1/rad2"),
        "q_w": (0.0, 0.1, "s2/rad2"),
        "r_v": (0.3, 0.7, "s2/m2"),
        "r_w": (0.4, 0.9, "s2/rad2"),
    },
}
"""Search ranges of Tab. 4.4 and 4.21, with units."""
_USUAL: Mapping[str, Mapping[str, tuple[float, float, str]]] = {
    **_PUBLISHED,
    "lqr-scheduled": {
        **{q: (0.01, 100.0, "1/m2") for q in ("q_x", "q_y")},
        "q_alpha": (0.01, 100.0, "1/rad2"),
        "q_v": (0.0, 10.0, "s2/m2"),
        "q_w": (0.0, 10.0, "s2/rad2"),
        "r_w": (0.05, 10.0, "s2/rad2"),
    },
    "smc": {
        "k_x": (0.0, 6.0, "1/s"),
        "eta_x": (0.0, 0.5, "m/s"),
        "phi_x": (0.005, 0.5, "m"),
        "slope": (0.2, 10.0, "rad/m"),
        "k_a": (0.0, 10.0, "1/s"),
        "eta_a": (0.0, 2.0, "rad/s"),
        "phi_a": (0.02, 1.0, "rad"),
    },
}
"""Gains that are searched unless others are named, with bounds and units."""
_BY_HAND: Mapping[str, Mapping[str, tuple[float, float, str]]] = {
    "pid": {"ff_u": (0.0, 2.0, "1"), "ff_w": (0.0, 2.0, "1")},
    "lqr": {"k_alpha": (0.0, 3.0, "1"), "k_y": (0.0, 3.0, "rad/m"), "k_i_rho": (0.0, 0.5, "1/s")},
    "lqr-scheduled": {"r_v": (0.05, 10.0, "s2/m2"), "k_i_rho": (0.0, 0.5, "1/s")},
    "smc": {
        **{f"k_{b}_{e}": (0.0, 2.0, u) for e in ("u", "w") for b, u in (("p", "1"), ("i", "1/s"))},
        "ff_u": (0.0, 2.0, "1"),
        "ff_w": (0.0, 2.0, "1"),
    },
}
"""Gains that the thesis sets by hand, and similar ones of other controllers."""


def make_tuning_space(
    controller: str, free: Sequence[str] | None, everything: bool, bounds: Mapping[str, tuple[float, float]]
) -> ParameterSpace:
    """Return the gains that are searched, with their usual bounds or those given.

    Args:
        controller: name of the controller.
        free: names of the gains; None for the usual ones.
        everything: search the gains too that the thesis sets by hand.
        bounds: lower and upper bounds by name.

    Raises:
        ValueError: an unknown gain, bounds for a gain that is not free, or bounds that make no sense.
    """
    known = {**_USUAL[controller], **_BY_HAND.get(controller, {})}
    names = list(free) if free is not None else list(known if everything else _USUAL[controller])
    for name in (*names, *bounds):
        if name not in known:
            raise ValueError(f"{controller} has no gain '{name}' to tune; there are: {', '.join(known)}")
    for name in bounds:
        if name not in names:
            raise ValueError(f"bounds are given for {name}, which is not free")
    return ParameterSpace(tuple(Parameter(name, known[name][2], *bounds.get(name, known[name][:2])) for name in names))
