"""This benchmark measures what a tick of an episode costs: `python -m benchmarks.learning [--out FILE.json]`.

- 64 episodes at once on one thread, in ticks a second and core, beginnings of episodes included; and one episode alone.
- The same beside bare rollouts of the same robots: what episodes, commands, targets, noise and observations cost.
- The usual physics step beside that of all other programs.

Times are the processor's, of one thread.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.rows import Row, alternate, at_most, report
from validation import cli
from validation.learning import TrackBatch, TrackTask

ROBOTS = 64
SECONDS = 20.0
"""Length of an episode [s]: that of `TrackTask`."""
FORMER = 650.0
"""Ticks a second and core of the environment of version 1.4: 590 to 700 on the machine of docs/learning.md [1/s]."""
ASKED_TIMES, ASKED_COST = 8.0, 1.8
"""Ticks over those of version 1.4, and times over bare rollouts [1], that are asked for; the solver needs fewer iterations
for robots that turn steadily than for those of episodes."""
PROFILE_STEP = 0.002
"""Physics step of the profile [s]."""


def follow_targets(batch: TrackBatch) -> None:
    """Drive one episode in every row, from its beginning, towards where the target will be."""
    seen = batch.reset()
    for _ in range(batch.source.most_ticks):
        commands = seen[:, [10, 11]] + 1.5 * seen[:, [2, 3]]  # the target's twist in 0.2 s, and two of its errors now
        seen = batch.step(commands).observations


def roll_bare(batch: TrackBatch) -> None:
    """Take the robots of a batch through as many physics steps of a bend, with nothing in between."""
    references = np.tile([1.5, 3.0], (len(batch), batch.source.steps, 1))
    pushes = np.zeros(references.shape[:2])
    for _ in range(batch.source.most_ticks):
        batch._bodies.advance(references, pushes)


def learning_rows(repeats: int, robots: int, seconds: float) -> list[Row]:
    """Time episodes of many robots and of one, bare rollouts, and the physics of all other programs, on one thread."""
    batches = [
        TrackBatch(TrackTask(seconds=seconds), robots, 1),
        TrackBatch(TrackTask(seconds=seconds), 1, 1),
        TrackBatch(TrackTask(seconds=seconds, timestep=PROFILE_STEP), robots, 1),
    ]
    for batch in batches:
        for row in range(len(batch)):
            batch.seed(row, row)
    many, single, exact = batches
    ticks = many.source.most_ticks
    ours, alone, slow, bare = alternate(
        lambda: follow_targets(many),
        lambda: follow_targets(single),
        lambda: follow_targets(exact),
        lambda: roll_bare(many),
        repeats=repeats,
        clock=time.process_time,
    )
    speed = robots * ticks / ours
    wanted = ASKED_TIMES * FORMER
    return [
        Row(
            f"{robots} episodes: ticks a second and core", speed, f">= {wanted:.0f}", ours, robots * seconds, speed >= wanted
        ),
        at_most(f"{robots} episodes / bare rollouts", ours, bare, ASKED_COST),
        Row("one episode: ticks a second and core", ticks / alone, "", alone, seconds, True),
        at_most(f"{robots} episodes: steps of 2 ms / steps of 5 ms", slow, ours),
    ]


def main(out: Path = Path("runs/benchmarks/learning.json"), repeats: int = 5, quick: bool = False) -> None:
    """Time the episodes of `validation.learning`; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each is timed; the fastest counts.
        quick: Time four short episodes once: a check that everything runs.
    """
    if repeats < 1:
        raise cli.UserError(f"--repeats {repeats} must be positive")
    rows = learning_rows(1, 4, 1.0) if quick else learning_rows(repeats, ROBOTS, SECONDS)
    report("benchmarks/learning: fastest processor times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.learning")
