"""Causes of what a balance leaves over: changes compete, and each is driven before it is named."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ssmr.errors import SsmrError
from validation.descriptions.balance import (
    LOADS,
    ONE_WHEEL,
    ROLLING,
    Balance,
    BalanceRow,
    weigh_robot,
)
from validation.descriptions.findings import Finding
from validation.descriptions.influences import STOPPING, Weighed
from validation.descriptions.mjcf_text import Edits, MjcfText, Part
from validation.descriptions.own_robot import OwnRobot
from validation.descriptions.remedies import MENDS, OPTION

_GAIN = 0.9
"""Residual over what it was before, from which a change helps [1]."""
LEAST_STEP = 0.001
"""Shortest physics step with which files of others are driven [s]: it bounds how long that takes.
Contacts that the simulator can hold at this step show what they do at a shorter one."""
_ROUNDS = 2
"""Times that it is looked for changes that are not needed."""
_HALVINGS = 4
"""Greatest number of times that the step is halved until the simulation runs."""
_OF_FILE = ("unlike_wheels", "wheel_shape", "axes", "friction_by_heading")
"""Kinds of what is wrong by the file alone: mended whatever drives say, if that harms none."""
_UNMENDED = ("weight_off", "hull", "inertia")
"""Kinds that no change of an attribute mends: what a robot else does wrong may follow from them."""
_EXPLAINING = (*STOPPING, *_OF_FILE, "which_friction", *_UNMENDED)
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
        known: Sequence[Finding],
    ) -> None:
        """Drive the robot, and the changes if a row is off.

        What keeps it from moving is mended first: whatever else it then does wrong follows.

        Args:
            robot: the model as it is.
            text: its file; None where nothing can be changed.
            files: the files that this names.
            weighed: what may spoil its motion, by the file alone.
            known: what is wrong by its numbers alone.

        Raises:
            SsmrError: its simulation fails whatever is changed.
        """
        self.files = files
        self.text = text
        self.kept = list[Remedy]()
        self.eaters = dict[str, str]()
        self.before = weigh_robot(robot)
        self.robot = robot
        self.after: Balance = self.before
        self.balances = dict[str, Balance]()
        self.known = {finding.kind for finding in known if finding.severity == "fault"}
        if text is not None:
            self.balances[text.edited({})] = self.before
            self._rescue()
        # mechanics knows nothing of a robot whose weight lies outside of its wheels, or of a slope
        leans = any(kind == "slope" and severity for kind, severity, _, _ in weighed)
        self.stands = ONE_WHEEL in self.before and not leans
        is_off = any(row.excess > 1.0 for row in self.before.values())
        robot = self.robot
        self.start = self.after
        self.rescues = len(self.kept)
        forced = self.known.intersection(_OF_FILE)
        if (
            text is None
            or not self.stands
            or not (is_off or forced)
            or self.known.intersection(_UNMENDED)
        ):
            return
        stops = bool(self.known.intersection(STOPPING))
        if stops:
            stopping = [line for line in weighed if line[0] in STOPPING]
            self._compete(robot, text, stopping, set())
        if len(self.kept) > self.rescues:
            self.rescues = len(self.kept)
            robot = self._built(self.kept)
            self.start = weigh_robot(robot)
        if _excess_of(self.start, LOADS) <= 1.0 or not stops:
            self._compete(robot, text, weighed, forced)

    def _built(self, remedies: Iterable[Remedy]) -> OwnRobot:
        """Return the robot with some changes."""
        assert self.text is not None
        return OwnRobot(self.text.edited(together(remedies)), self.files, least_step=LEAST_STEP)

    def _rescue(self) -> None:
        """Take the integrator and the step with which its simulation runs, if it does not."""
        step = self.robot.timestep
        cause = f"the simulation diverges with its step of {1e3 * step:g} ms"
        for halvings in range(_HALVINGS + 1 if self.robot.measures["diverged"] else 0):
            values = {"integrator": "implicitfast"}
            if halvings > 0:
                values["timestep"] = f"{step / 2**halvings:g}"
            rescue = ("step", cause, {OPTION: values})
            mended = self._built([rescue])
            after = weigh_robot(mended)
            if not mended.measures["diverged"]:
                self.robot = mended
                self.kept = [rescue]
                self.after = after
                # what it did before it diverged is nothing to be compared
                row = next(iter(self.before.values()))
                self.before = {**after, row.row: row}
                break

    def _tried(self, remedies: Iterable[Remedy]) -> Balance:
        """Return the balance with some changes; empty where the simulator fails."""
        assert self.text is not None
        made = list(remedies)
        text = self.text.edited(together(made))
        # a round asks again for most of what the one before has driven
        if text not in self.balances:
            try:
                self.balances[text] = weigh_robot(self._built(made))
            except (ValueError, SsmrError):
                self.balances[text] = {}
        return self.balances[text]

    def _compete(
        self, robot: OwnRobot, text: MjcfText, weighed: Sequence[Weighed], forced: set[str]
    ) -> None:
        """Make all changes of a robot, and take away again each that is not needed."""
        kept = list(self.kept)
        rescues = len(kept)
        for kind, _, cause, mend in weighed:
            edits = MENDS[mend](robot, text) if mend else {}
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
    def findings(self) -> list[Finding]:
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
                was = self._before(remedy)[row]
                self.eaters[row] = remedy[1]
                found.append(_judge_change(remedy[0], remedy[1], was, self.after, lines))
        explained = self.known.intersection(_EXPLAINING)
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
            # what it does else follows
            if is_left and row == LOADS and weighed.excess > 1.0:
                break
        return found + _ask_about(self.robot)

    def rows(self) -> list[BalanceRow]:
        """Return the balance with what eats the differences, once its findings are known."""
        return [
            row._replace(cause=self.eaters.get(name, row.cause))
            for name, row in self.before.items()
        ]

    @property
    def closes(self) -> bool:
        """Whether no row is off after the changes, of a robot that its own motors drive."""
        is_driven = bool(self.robot.driven.all()) and not self.robot.given_rates
        return is_driven and self.stands and all(r.excess <= 1.0 for r in self.after.values())

    def _before(self, remedy: Remedy) -> Balance:
        """Return the balance that a change starts from: that of the file, or once it can move."""
        return self.before if remedy in self.kept[: self.rescues] else self.start

    def _own_row(self, remedy: Remedy) -> str:
        """Return the row that gains most by a change beside the others; empty where none does."""
        first = next(iter(self.before))
        without = self._tried(other for other in self.kept if other is not remedy)
        gains = {
            row: gain for row, gain in _gains_of_rows(without, self.after).items() if gain > 0.0
        }
        if not gains and len(self.kept) == 1:
            return first
        before = self._before(remedy)
        closer = _gains_of_rows(before, self.after)
        rows = [row for row in gains if closer.get(row, 0.0) > 0.0 and row in before]
        # what the simulator ends, or no wheel carries, does nothing else
        rows.sort(key=lambda row: -min(gains[row], closer[row]))
        rows.sort(key=lambda row: (row not in (first, LOADS), row.startswith(ROLLING)))
        return next(iter(rows), "")


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
    if robot.longer_step > 1.0:
        cause = (
            f"timestep of <option> makes it {robot.longer_step:.3g} times slower than drives here "
            f"need: they have {1e3 * robot.timestep:g} ms and implicitfast"
        )
        asked.append(Finding("step", "question", cause))
    if not robot.driven.all():
        still = ", ".join(np.array(robot.names)[~robot.driven])
        cause = f"no servo drives the wheels {still}: they roll along, and closed forms here have "
        change = "give each wheel a servo, or tie the wheels of a side"
        asked.append(Finding("driven", "question", f"{cause}four driven wheels", change))
    return asked
