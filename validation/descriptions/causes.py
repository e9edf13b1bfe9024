"""Causes of what a balance leaves over: changes compete, and each is driven before it is named."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ssmr.errors import SsmrError
from validation.descriptions.balance import ONE_WHEEL, ROLLING, Balance, BalanceRow, weigh_robot
from validation.descriptions.findings import Finding
from validation.descriptions.influences import STOPPING, Weighed
from validation.descriptions.mjcf_text import Edits, MjcfText, Part
from validation.descriptions.own_robot import OwnRobot
from validation.descriptions.remedies import MENDS, OPTION

_GAIN = 0.9
"""Residual over what it was before, from which a change helps [1]."""
_ROUNDS = 2
"""Times that it is looked for changes that are not needed."""
_HALVINGS = 4
"""Greatest number of times that the step is halved until the simulation runs."""
_OF_FILE = ("unlike_wheels", "wheel_shape", "axes", "friction_by_heading")
"""Kinds of what is wrong by the file alone: mended whatever drives say, if that harms none."""
_EXPLAINING = (*STOPPING, *_OF_FILE, "which_friction", "weight_off", "hull")
"""Kinds that a file alone shows and that leave residuals in a balance."""
Remedy = tuple[str, str, Edits]
"""Kind of a finding, a sentence on the cause, and the edits that take it away."""


def _excess_of(balance: Balance, row: str) -> float:
    """Return the residual of a row over its limit; infinite where it could not be driven."""
    return min(balance[row].excess, 1e6) if row in balance else 1e6


def _gains_of_rows(before: Balance, after: Balance) -> dict[str, float]:
    """Return by how much rows that are off come closer, in their limits; negative for a harm."""
    gains = {}
    for row in {**before, **after}:
        was = _excess_of(before, row)
        now = _excess_of(after, row)
        if max(was, now) > 1.0 and min(was, now) < _GAIN * max(was, now):
            gains[row] = was - now
    return gains


class Competition:
    """Changes of a model, of which those are left without which a row is off that else is not."""

    def __init__(
        self,
        robot: OwnRobot,
        text: MjcfText | None,
        files: Mapping[str, bytes],
        weighed: Sequence[Weighed],
    ) -> None:
        """Drive the robot, and the changes if a row is off.

        Args:
            robot: the model as it is.
            text: its file; None where nothing can be changed.
            files: the files that this names.
            weighed: what may spoil its motion, by the file alone.

        Raises:
            SsmrError: its simulation fails whatever is changed.
        """
        self.files = files
        self.text = text
        self.kept = list[Remedy]()
        self.eaters = dict[str, tuple[float, str]]()
        self.before = weigh_robot(robot)
        self.robot = robot
        self.after: Balance = self.before
        self.balances = dict[str, Balance]()
        if text is not None:
            self.balances[text.edited({})] = self.before
            self._rescue(text)
        # mechanics knows nothing of a robot whose weight lies outside of its wheels, or of a slope
        leans = any(kind == "slope" and severity for kind, severity, _, _ in weighed)
        self.stands = ONE_WHEEL in self.before and not leans
        is_off = any(row.excess > 1.0 for row in self.before.values())
        faults = {kind for kind, severity, _, _ in weighed if severity == "fault"}
        forced = faults.intersection(_OF_FILE)
        if text is not None and self.stands and (is_off or forced):
            self._compete(text, weighed, forced)

    def _rescue(self, text: MjcfText) -> None:
        """Take the integrator and the step with which its simulation runs, if it does not."""
        step = self.robot.timestep
        cause = f"the simulation diverges with its step of {1e3 * step:g} ms"
        for halvings in range(_HALVINGS + 1):
            if self.robot.measures["diverged"] == 0.0:
                break
            values = {"integrator": "implicitfast"}
            if halvings > 0:
                values["timestep"] = f"{step / 2**halvings:g}"
            rescue = ("step", cause, {OPTION: values})
            mended = OwnRobot(text.edited(rescue[2]), self.files)
            after = weigh_robot(mended)
            if mended.measures["diverged"] == 0.0:
                self.robot = mended
                self.kept = [rescue]
                self.after = after
                # what it did before it diverged is nothing to be compared
                row = next(iter(self.before.values()))
                self.before = {**after, row.row: row}

    def _tried(self, remedies: Iterable[Remedy]) -> Balance:
        """Return the balance with some changes; empty where the simulator fails."""
        assert self.text is not None
        text = self.text.edited(together(remedies))
        # a round asks again for most of what the one before has driven
        if text not in self.balances:
            try:
                self.balances[text] = weigh_robot(OwnRobot(text, self.files))
            except (ValueError, SsmrError):
                self.balances[text] = {}
        return self.balances[text]

    def _compete(self, text: MjcfText, weighed: Sequence[Weighed], forced: set[str]) -> None:
        """Make all changes, and take away again each that is not needed."""
        kept = list(self.kept)
        rescues = len(kept)
        for kind, _, cause, mend in weighed:
            edits = MENDS[mend](self.robot, text) if mend else {}
            if edits:
                kept.append((kind, cause, edits))
        after = self._tried(kept)
        for _ in range(_ROUNDS):
            for remedy in kept[:rescues:-1] + kept[rescues : rescues + 1]:
                fewer = [other for other in kept if other is not remedy]
                without = self._tried(fewer)
                gains = _gains_of_rows(without, after)
                helps = max(gains.values(), default=0.0) > 0.0 or remedy[0] in forced
                if helps and min(gains.values(), default=0.0) >= 0.0:
                    continue
                if sum(gains.values()) <= 0.0 or min(gains.values(), default=0.0) >= 0.0:
                    kept = fewer
                    after = without
        self.kept = kept
        self.after = after

    # ------------------------------------------------------------------------- findings
    def findings(self, known: Sequence[Finding]) -> list[Finding]:
        """Return each change that is left as a finding with its row, and what nothing explains."""
        found = list[Finding]()
        with_row = [(remedy, self._own_row(remedy)) for remedy in self.kept]
        final = together(self.kept)
        # what only keeps another change from doing harm is written with that one
        added = [remedy for remedy, row in with_row if not row]
        for remedy, row in with_row:
            if row and self.text is not None:
                changes = together([remedy, *added])
                added = []
                lines = _in_lines(final, changes, self.text)
                found.append(
                    _judge_change(remedy[0], remedy[1], self.before[row], self.after, lines)
                )
        explained = {f.kind for f in known if f.severity == "fault"}.intersection(_EXPLAINING)
        told = set[str]()
        for row, weighed in self.before.items():
            is_left = _excess_of(self.after, row) > 1.0 and self.stands and not explained
            # what one cause eats is told by its first row
            if weighed.excess > 1.0 and weighed.cause in told:
                continue
            if is_left or (row.startswith(ROLLING) and weighed.excess > 1.0):
                cause = f"{row} {weighed.words}"
                cause += f" ({weighed.cause})" if weighed.cause else ""
                found.append(_judge_change("unexplained", cause, weighed, self.after))
                told |= {weighed.cause} - {""}
        return found + _ask_about(self.robot)

    def rows(self) -> list[BalanceRow]:
        """Return the balance with what eats the differences, once its findings are known."""
        rows = []
        for name, row in self.before.items():
            if row.excess > 1.0 and name in self.eaters:
                row = row._replace(cause=self.eaters[name][1])
            rows.append(row)
        return rows

    @property
    def closes(self) -> bool:
        """Whether no row is off after the changes, of a robot that its own motors drive."""
        is_driven = bool(self.robot.driven.all()) and not self.robot.given_rates
        return is_driven and self.stands and all(r.excess <= 1.0 for r in self.after.values())

    def _own_row(self, remedy: Remedy) -> str:
        """Return the row that gains most by a change beside the others; empty where none does."""
        first = next(iter(self.before))
        if remedy[0] == "step" and self.before[first].excess > 1.0:
            return first
        without = self._tried(other for other in self.kept if other is not remedy)
        gains = {
            row: gain for row, gain in _gains_of_rows(without, self.after).items() if gain > 0.0
        }
        if not gains and len(self.kept) == 1:
            return first
        for row, gain in gains.items():
            self.eaters[row] = max(self.eaters.get(row, (0.0, "")), (gain, remedy[1]))
        closer = _gains_of_rows(self.before, self.after)
        rows = [row for row in gains if closer.get(row, 0.0) > 0.0 and row in self.before]
        return max(rows, key=lambda row: min(gains[row], closer[row]), default="")


def _judge_change(
    kind: str, cause: str, row: BalanceRow, after: Balance, lines: str | None = None
) -> Finding:
    """Return a finding with the numbers of its row before and after the changes."""
    is_rolling = row.row.startswith(ROLLING)
    if is_rolling and kind == "unexplained":
        kind = "rolls"
        cause += ": wheels turn at rest, for a servo of rates holds a rate and no place"
    later = after[row.row].words if row.row in after else "it does not run"
    return Finding(
        kind,
        "question" if is_rolling else "fault",
        cause,
        lines,
        f"{row.row} {row.words}",
        later,
    )


def together(remedies: Iterable[Remedy]) -> Edits:
    """Return the edits of several changes; of one attribute the last one counts."""
    edits = dict[Part, Mapping[str, str]]()
    for _, _, change in remedies:
        for part, values in change.items():
            edits[part] = {**edits.get(part, {}), **values}
    return edits


def _in_lines(final: Edits, edits: Edits, text: MjcfText) -> str:
    """Return edits as lines of the file and what to write there, with their final values."""
    lines = dict[str, set[int]]()
    for part, values in edits.items():
        words = [f'{attribute}="{final[part][attribute]}"' for attribute in values]
        wanted = f"<{text.tag(part)} {' '.join(words)}>"
        lines.setdefault(wanted, set()).add(text.line(part))
    parts = []
    for wanted, numbers in lines.items():
        parts.append(f"line {', '.join(map(str, sorted(numbers)))}: {wanted}")
    return "; ".join(parts)


def _ask_about(robot: OwnRobot) -> list[Finding]:
    """Return questions about what was driven otherwise than as the file has it."""
    asked = []
    if robot.is_fixed:
        cause = "its base is fixed to the world, so it does not move; here it is free"
        asked.append(Finding("held", "question", cause, "give its base a <freejoint/>"))
    if not robot.driven.all():
        still = ", ".join(np.array(robot.names)[~robot.driven])
        cause = f"no servo drives the wheels {still}: they roll along, and closed forms here have "
        change = "give each wheel a servo, or tie the wheels of a side"
        asked.append(Finding("driven", "question", f"{cause}four driven wheels", change))
    return asked
