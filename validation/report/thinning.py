"""How a long recording is thinned: to what no eye can see, so that hours of five plants fit into a file of 150 MB.

Robots are shown, and lines over time are drawn, with so many samples at most. The lines keep the least and the greatest
value of every stretch: their outline is the whole one's.
"""

from __future__ import annotations

import numpy as np

from ssmr.types import FloatArray, IndexArray

POSE_PERIOD = 0.02
"""Time between two poses of a robot [s]: 50 Hz is smooth to the eye."""
MOST_POSES = 45_000
"""Most poses of a robot: 50 Hz for a quarter of an hour, 6 Hz for two hours."""
MOST_SAMPLES = 45_000
"""Most samples of lines over time: twenty for each point of a screen's width."""


def pose_period(seconds: float) -> float:
    """Return the time between two poses of a robot that is shown for so long [s]."""
    return max(POSE_PERIOD, seconds / MOST_POSES)


def note(period: float, samples: int) -> str:
    """Return a paragraph that says how a recording is thinned; empty where it is not.

    Args:
        period: time between two poses of a robot [s].
        samples: most samples of a line over time.
    """
    said = []
    if period > POSE_PERIOD:
        said.append(f"shows robots and paths every {period:.2f} s")
    if samples > MOST_SAMPLES:
        said.append(f"draws lines over time through their least and greatest values, {MOST_SAMPLES} of {samples} samples")
    return f"\n\nThis recording is long. To keep the file small, it {' and '.join(said)}.\n" if said else ""


def outline_of(values: FloatArray, most: int = MOST_SAMPLES) -> IndexArray:
    """Return the indices of at most `most` samples that outline lines over time; all of them where there are no more.

    Args:
        values: (M,) or (M, k) values of k lines.
        most: most samples, at least 2 k + 2.
    """
    table = values.reshape(len(values), -1)
    m, k = table.shape
    if m <= most:
        return np.arange(m)
    edges = np.linspace(0, m, (most - 2) // (2 * k) + 1).astype(np.intp)
    lengths, starts = np.diff(edges), edges[:-1]
    rows = np.minimum(starts[:, None] + np.arange(lengths.max()), edges[1:, None] - 1)  # shorter stretches repeat their end
    inside = table[rows]
    kept = [starts[:, None] + pick(inside, axis=1) for pick in (np.argmin, np.argmax)]
    return np.unique(np.concatenate([[0, m - 1], *(np.minimum(found, m - 1).ravel() for found in kept)])).astype(np.intp)
