"""Motions of plants against one reference: a comparison, its tables, sentences and recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations, product, zip_longest
from pathlib import Path

import numpy as np

from ssmr.metrics.declared import METRICS, SIGNALS, Metric
from ssmr.metrics.paired import SIGNIFICANCE, chance_of_difference, correct_by_holm
from ssmr.metrics.windows import (
    EVERY_S,
    SHORTEST_BLOCK_S,
    OverlappingErrors,
)
from ssmr.types import FloatArray, Trajectory
from validation.experiment.gyro import GyroJudge
from validation.experiment.runs import Runs
from validation.experiment.scores import NamedScores, Scores, headline_horizon, standing_sentences
from validation.experiment.sources import RECORDING, Source
from validation.output import Document, one_line
from validation.plants.table import plant_kind
from validation.report.columns import DEGREES, METRES, REAL_TIME, Unit, declare, length_unit
from validation.report.driven import DrivenRobots, GivenCommands
from validation.report.scene_robots import Plots, Series, Track, shades_of
from validation.report.table import Table
from validation.simulator.description import WHEELS
from validation.simulator.health import health_verdict
from validation.simulator.terrain import FLAT

_COMMANDED = (86, 180, 233)
_WINDOWS = (
    "after this time, of the relative pose: the simulation's motion over a window is compared with "
    "the reference's, both seen from the pose at the window's start. Windows span no gap"
)
declare(
    Metric(
        "position_median_m",
        "position median",
        "m",
        "low",
        f"median error of the position {_WINDOWS}",
    ),
    Metric(
        "yaw_median_rad",
        "yaw median",
        "rad",
        "low",
        "median error of the heading over the same windows",
    ),
    Metric(
        "yaw_gyro_median_rad",
        "yaw by gyro",
        "rad",
        "low",
        "yaw median with the log's gyro as the judge of heading",
    ),
)
_INTERVALS = (
    "Medians over windows that begin every second, with 90 % confidence of the median; for a log "
    "of less than four horizons, with the range of errors."
)
_SCORES = (
    "Score: the band's width and 20 times what lies beyond its edge, the mean over windows; less "
    "is better. A band knows what changed within its logs, not what changes after them: it misses "
    "a robot that turns 5 % more on another day."
)
_ALIKE = 0.02
"""Relative difference below which two errors are printed once."""
_HEALTH = (
    "apparent mass: push force divided by acceleration",
    "peak torque: largest motor torque on one side",
    "load sum rms: rms difference between the total wheel load and the weight",
)
_LOAD_COLUMNS = {
    "at_rest_N": "static_N",
    "mean_N": "mean_N",
    "least_N": "lowest_N",
    "greatest_N": "highest_N",
    "off_ground_share": "off_ground_share",
}
"""Columns of the loads of wheels, and what they are of a run's loads."""
_HEALTH_COLUMNS = ("apparent_mass_kg", "peak_torque_N_m", "load_sum_rms_N", "verdict")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Motions(DrivenRobots):
    """Every plant beside the reference on one source: all of a comparison but its picture."""

    program = "compare"
    source: Source
    """Motion that the plants were driven along."""
    reference: str
    """Name of the reference plant, or `recording`."""
    truth: tuple[Trajectory, ...]
    """The reference's motion, piece by piece."""
    runs: Runs
    """Runs by plant, in the order of all tables; the reference plant is among them."""
    scores: NamedScores
    """Their errors, by plant."""
    gyro: GyroJudge | None = None
    """The second judge of heading; None where the reference is a plant, or without a useful one."""

    def motions(self) -> dict[str, Sequence[Trajectory]]:
        """Return the motions of each plant, piece by piece."""
        return {name: run.motions for name, run in self.runs.items()}

    @property
    def gyro_first(self) -> bool:
        """Whether the gyro is the first judge of heading."""
        return self.gyro is not None and self.gyro.first

    @property
    def horizons(self) -> Sequence[float]:
        """Times after which poses are compared [s]; none where the reference is a plant."""
        return self.options["horizons"] if self.reference == RECORDING else ()

    @cached_property
    def alike(self) -> Document | None:
        """Plants that the recording does not tell apart, see `indistinguishable_pairs`."""
        return indistinguishable_pairs(self.scores, self.gyro_first)

    def tables(self) -> list[Table]:
        """Return the errors by horizon of a recording, the metrics of paths, loads and health."""
        errors = []
        by_gyro = []
        for h, (names, s) in product(sorted(self.horizons), self.distinct.items()):
            if h in s.overlapping:
                errors.append((h, names, s.overlapping[h]))
                by_gyro.append(s.overlapping_by_gyro.get(h))
        tables = [
            interval_table(errors, gyro=by_gyro, gyro_first=self.gyro_first),
            _band_table(self.distinct),
            self._metrics_table(),
            _load_table(self.runs),
            _health_table(self.runs),
        ]
        return [table for table in tables if table.rows]

    @cached_property
    def distinct(self) -> NamedScores:
        """Scores by plant; planar models that a log's wheel rates drive alike share their names."""
        distinct = dict[str, Scores]()
        for name, scores in self.scores.items():
            if alike := [n for n, s in distinct.items() if _is_alike(s, scores)]:
                distinct[f"{alike[0]}, {name}"] = distinct.pop(alike[0])
            else:
                distinct[name] = scores
        return distinct

    def verdict(self) -> str:
        """Return the error of the best simulation of a recording, and whether others are worse."""
        if self.alike is None:
            return ""
        h = self.alike["horizon_s"]
        errors = {name: s.overlapping[h] for name, s in self.distinct.items()}
        best = min(errors, key=lambda name: errors[name].position_median_m)
        beaten = {worse for better, worse in self.alike["better"]["position"] if better in best}
        equal = [name for name in errors if name != best and name.split(", ")[0] not in beaten]
        words = "All others are worse by more than chance."
        if len(equal) == len(errors) - 1:
            words = "No other is worse by more than chance." if equal else ""
        elif equal:
            words = f"Not worse by more than chance: {'; '.join(equal)}."
        error = headline_error(self.scores[best.split(", ")[0]])
        return f"{best} errs least: {error}. {words}".strip()

    def _metrics_table(self) -> Table:
        """Metrics of paths, with what one must know to read them below."""
        metrics = dict.fromkeys(chain.from_iterable(s.metrics for s in self.scores.values()))
        # metrics that no table declares stand last
        columns = [key for key in dict.fromkeys((*_COLUMNS, *metrics)) if key in metrics]
        marked = f"{self.reference} (ref)"
        rows = []
        for name, s in self.distinct.items():
            shown = {key: s.metrics.get(key) for key in columns}
            shown[REAL_TIME.name] = self.runs[name.split(", ")[0]].real_time_factor
            rows.append({"plant": marked if name == self.reference else name, **shown})
        title = f"{one_line(self.source.name)} · profile {self.profile_label}"
        if self.terrain != FLAT:
            title += f" · mujoco on {self.terrain.words}"
        caption = [
            f"compared with {self.reference} · smaller is better, a ratio nearer to 1; best value "
            f"in bold · seed {self.seed}"
        ]
        if self.reference == RECORDING:
            caption.append(
                "d_ratio and e_bend compare lengths of paths: noise of a log's poses makes its "
                "path longer."
            )
        else:
            caption += _point_sentences(self.runs)
            caption += self.profile.origins(self.runs, self.source.name)
            caption += self._unlike_torques()
        caption += health_warnings(self.runs)
        return Table(
            title, rows, "\n".join(caption), best=True, reference=marked, hidden=_BOTH_WAYS
        )

    def _unlike_torques(self) -> list[str]:
        """Return a sentence on torques that differ because only one of two is a body's."""
        of_body = plant_kind(self.reference).torques
        with_torque = [n for n, s in self.scores.items() if "torque_rms_N_m" in s.metrics]
        unlike = [name for name in with_torque if plant_kind(name).torques != of_body]
        if not unlike:
            return []
        return [
            f"torque rms does not compare {', '.join(unlike)} with {self.reference}: a planar "
            "model's torques come of frictions that were fitted to paths."
        ]

    def notes(self) -> list[str]:
        """Return the remarks, the source's faults, the judge of heading, and who is better."""
        notes = super().notes()
        headline = headline_horizon(self.horizons)
        if headline:
            notes += standing_sentences(self.source, headline)
        if self.gyro is not None:
            notes.append(self.gyro.sentence)
        for names in self.distinct:
            if ", " in names:
                notes.append(
                    f"{names}: wheel rates are given, so frictions and motors have no part in it, "
                    "and planar models are one kinematics with a centre of turns of their own; the "
                    f"numbers of their row are of {names.split(', ')[0]}, and the others' differ "
                    f"by less than {100.0 * _ALIKE:g} %"
                )
        return [*notes, *self.source.warnings, *_alike_sentences(self.scores, self.alike)]

    def document(self) -> Document:
        """Return the contents of compare.json without options and tables."""
        plants = {}
        for name, run in self.runs.items():
            plants[name] = {**run.as_dict(), **self.scores[name].as_dict()}
        return {
            "schema": "ssmr.compare/1",
            "source": self.source.name,
            "profile": self.profile.name,
            "robot": self.profile.robot.name,
            "reference": self.reference,
            "seed": self.seed,
            **({} if self.gyro is None else self.gyro.as_dict()),
            "alike": self.alike,
            "plants": plants,
            "parameters": self.profile.as_dict(self.runs),
        }

    def tracks(self) -> list[Track]:
        """Return all robots, the reference first."""
        # a recording was tracked at the point that every plant's section of the profile says
        first = self.runs.get(self.reference, next(iter(self.runs.values())))
        scene = (self.terrain, self.profile.robot)
        reference = Track(self.reference, self.truth, None, first.localiser, *scene)
        tracks = [reference]
        for name, run in self.runs.items():
            if name != self.reference:
                tracks.append(Track(name, run.motions, reference, run.localiser, *scene))
        return tracks

    def commanded(self) -> GivenCommands:
        """Return the commands over the time that is shown, if they are speeds and yaw rates."""
        by_wheels = any(piece.commands.kind == "wheels" for piece in self.source.pieces)
        low, high = self.shown_span
        shown = ((t, each, (t >= low) & (t <= high)) for t, each in self._given())
        return [] if by_wheels else [(t[k], each[k]) for t, each, k in shown if np.any(k)]

    def _given(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield (N + 1,) instants [s] and (N + 1, 2) commands of every piece.

        The last command stands once more at the end of its piece.
        """
        for piece, motion in zip(self.source.pieces, self.truth, strict=True):
            c = piece.commands
            t = motion.t[0] + c.dt * np.arange(c.n + 1)
            yield t, np.vstack([c.values, c.values[-1:]])

    def record(self, path: Path) -> None:
        """Write the robots in motion, and the commands that drove them, see `Report.record`."""
        from validation.report.scene import write_scene  # here: rerun may be missing

        title = f"{self.source.name}, profile {self.profile_label}"
        write_scene(self, title, self.drawn, self._command_plots(), path)

    def _command_plots(self) -> Plots:
        """Commands over time, as a recording's plots have them."""
        t, values = (np.concatenate(parts) for parts in zip(*self._given(), strict=True))
        if not self.commanded():
            names = ["left commanded", "right commanded"]
            inks = shades_of(_COMMANDED)
            given = Series(names, "rad/s", inks, t, values, held=True)
            return {"wheel_rate/commanded": given.thinned()}
        plots = {}
        for column, (quantity, unit) in enumerate((("speed", "m/s"), ("yaw_rate", "rad/s"))):
            plots[f"{quantity}/commanded"] = Series(
                ["commanded"], unit, [_COMMANDED], t, values[:, column], held=True
            ).thinned()
        return plots


_COLUMNS = ("d_rms_m", "sync_rms_m", "yaw_rms_rad", *SIGNALS, *METRICS)
_BOTH_WAYS = frozenset({"d_rms_symmetric_m", "d_haus_symmetric_m"})  # compare.json has them
_POSES = {
    "horizon_s": Unit("s", 1.0, 0, significant=3),
    "position_median_m": METRES,
    "yaw_median_rad": DEGREES,
    "yaw_gyro_median_rad": DEGREES,
}


def _is_alike(a: Scores, b: Scores) -> bool:
    """Return whether the medians of two plants hardly differ at any horizon."""
    one, other = (
        np.array([(e.position_median_m, e.yaw_median_rad) for e in scores.overlapping.values()])
        for scores in (a, b)
    )
    return bool(one.size) and np.allclose(one, other, rtol=_ALIKE, atol=0.0)


def interval_table(
    overlapping: Sequence[tuple[float, str, OverlappingErrors]],
    who: str = "plant",
    gyro: Sequence[OverlappingErrors | None] = (),
    gyro_first: bool = False,
) -> Table:
    """Return medians over overlapping windows with their intervals, by horizon [s] and name.

    `gyro` has for each row the errors with the gyro as the judge of heading, in the column before
    or after the localiser's.
    """
    rows = []
    for (h, name, e), other in zip_longest(overlapping, gyro):
        position = (e.position_median_m, e.position_low_m, e.position_high_m)
        row = {"horizon_s": h, who: name, "windows": e.n, "position_median_m": position}
        judges = [("yaw_median_rad", e)]
        if other is not None:
            judges.insert(0 if gyro_first else 1, ("yaw_gyro_median_rad", other))
        for key, of in judges:
            row[key] = (of.yaw_median_rad, of.yaw_low_rad, of.yaw_high_rad)
        rows.append(row)
    title = "Error of the relative pose after a horizon"
    return Table(title, rows, _INTERVALS, "horizon_s", units=_POSES)


def _band_table(scores: NamedScores) -> Table:
    """Shares of windows at whose end the robot was inside the plants' bands, and their scores."""
    rows = []
    for h in sorted(set().union(*(r.held for r in scores.values()))):
        for name, r in scores.items():
            row = {"horizon_s": h, "plant": name}
            for part, (share, score) in r.held.get(h, {}).items():
                row[f"{part}_inside_share"] = share
                row[f"{part}_score_m" if part == "position" else f"{part}_score_rad"] = score
            if len(row) > 2:
                rows.append(row)
    return Table(
        "Windows that end inside the band, which promises 90 %",
        rows,
        _SCORES,
        group="horizon_s",
        units=_POSES,
    )


def _load_table(runs: Runs) -> Table:
    rows = []
    captions = []
    for name, result in runs.items():
        loads = result.loads
        if loads is None:
            continue
        for i, wheel in enumerate(WHEELS):
            shown = {key: loads[kept][i] for key, kept in _LOAD_COLUMNS.items()}
            rows.append({"plant": name, "wheel": wheel.replace("_", " "), **shown})
        captions.append(
            f"{name}: rms {loads['static_rms_N']:.1f} N from the loads at rest, "
            f"{loads['quasi_static_rms_N']:.1f} N from quasi-static load transfer"
        )
    return Table("Wheel loads", rows, "\n".join(captions), "plant")


def _health_table(runs: Runs) -> Table:
    rows = []
    for name, result in runs.items():
        h = result.health
        if h is not None:
            known = {**h, "verdict": health_verdict(h)}
            rows.append({"plant": name} | {key: known.get(key) for key in _HEALTH_COLUMNS})
    return Table("Health", rows, "\n".join(_HEALTH), units={"load_sum_rms_N": Unit("N", 1.0, 1)})


def indistinguishable_pairs(scores: NamedScores, gyro_first: bool = False) -> Document | None:
    """Return which plants a recording tells apart, as compare.json has them; None without windows.

    Medians over overlapping windows are compared, after the horizon closest to `HEADLINE_HORIZON`,
    by a paired test that is corrected for the number of pairs: `{"horizon_s", "position": [[name,
    name], ...], "yaw": [...], "better": {"position": [[better, worse], ...], "yaw": [...]}}`, where
    the first two lists hold the pairs that cannot be told apart. The first judge of heading
    decides.
    """
    horizon = headline_horizon(chain.from_iterable(r.windows for r in scores.values()))
    if horizon is None:
        return None
    names = [name for name, r in scores.items() if horizon in r.windows]
    pairs = list(combinations(names, 2))
    block = max(horizon, SHORTEST_BLOCK_S)
    alike: Document = {"horizon_s": horizon, "position": [], "yaw": []}
    alike["better"] = {"position": [], "yaw": []}
    for quantity, better in alike["better"].items():
        errors = {}
        for name in names:
            r = scores[name]
            windows = r.by_gyro if gyro_first and quantity == "yaw" else r.windows
            errors[name] = getattr(windows[horizon], quantity)
        chances = []
        for a, b in pairs:
            times = EVERY_S * np.arange(len(errors[a]))
            chances.append(chance_of_difference(errors[a], errors[b], times, block))
        medians = {name: np.median(values) for name, values in errors.items()}
        for pair, chance in zip(pairs, correct_by_holm(chances).tolist(), strict=True):
            if chance < SIGNIFICANCE:
                better.append(sorted(pair, key=medians.__getitem__))
            else:
                alike[quantity].append(list(pair))
    return alike


def _alike_sentences(scores: NamedScores, alike: Document | None) -> list[str]:
    """Return sentences on the plants that a recording tells apart, and on those that it does not.

    `alike` is the result of `indistinguishable_pairs`.
    """
    if alike is None:
        return []
    sentences = []
    horizon = alike["horizon_s"]
    n = sum(horizon in result.windows for result in scores.values())
    after = f"After {horizon:g} s"
    none_clear = f"{after} the recording shows no clear difference"
    for quantity, better in alike["better"].items():
        pairs = [" and ".join(pair) for pair in alike[quantity]]
        if better:
            ranks = ", ".join(" than ".join(pair) for pair in better)
            sentences.append(
                f"{after} these are better in {quantity}, by more than chance: {ranks}."
            )
        if len(pairs) == n * (n - 1) // 2 > 1:
            sentences.append(f"{none_clear} between any two of these simulations in {quantity}.")
        elif pairs:
            sentences.append(f"{none_clear} in {quantity} between {', '.join(pairs)}.")
    return sentences


def _point_sentences(runs: Runs) -> list[str]:
    """Return a sentence that says at which points of the robots the paths are taken."""
    points = {name: r.localiser.point for name, r in runs.items()}
    if not np.any(list(points.values())):
        return ["All paths are those of the robot's middle."]
    spots = [f"{name} ({1e3 * x:.0f}, {1e3 * y:.0f}) mm" for name, (x, y) in points.items()]
    return [
        "Paths are those of points on the robot, ahead and to the left of the middle between its "
        f"axles: {', '.join(spots)}."
    ]


def health_warnings(runs: Runs) -> list[str]:
    """Return a sentence for each plant with whose physics something is wrong."""
    warnings = []
    for name, result in runs.items():
        health = result.health
        if health is not None and health["advice"]:
            subject = name if health["ok"] else f"{name} is unhealthy"
            warnings.append(f"{subject}: {one_line(health['advice'])}.")
    return warnings


def headline_error(scores: Scores, beside: Iterable[float] = ()) -> str:
    """Return a plant's error, with its unit, for places with no room for more.

    Where there are horizons, it is the median errors after the horizon closest to
    `HEADLINE_HORIZON`; else d_rms, in the unit and digits of those `beside` it [m].
    """
    horizon = headline_horizon(scores.overlapping)
    if horizon is not None:
        errors = scores.overlapping[horizon]
        length = length_unit([errors.position_median_m])
        coarse = replace(length, decimals=0 if length.symbol == "mm" else 2)
        fine = replace(DEGREES, decimals=1, significant=2)
        yaw = fine.text(errors.yaw_median_rad).removesuffix(".0")
        return f"{coarse.text(errors.position_median_m)} {length.symbol}, {yaw}° in {horizon:g} s"
    d_rms = scores.metrics["d_rms_m"]
    length = length_unit([d_rms, *beside])
    return f"d_rms {length.text(d_rms)} {length.symbol}"
