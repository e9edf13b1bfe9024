"""A sweep measures every variant, keeps what was finished, and says what failed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from ssmr.errors import SsmrError
from validation.output import Progress
from validation.sweep import sweep

VARIANTS = {f"v{k}": k for k in range(6)}


def squared(k: int) -> Mapping[str, Any]:
    return {"square": k * k}


def odd_alone(k: int) -> Mapping[str, Any]:
    if k % 2 == 0:
        raise SsmrError("an even number\ndiverges")
    return {"odd": k}


@pytest.mark.parametrize("workers", [1, 3])
def test_rows_stand_in_the_order_of_the_variants_whatever_the_workers(workers: int) -> None:
    done: list[Progress] = []
    swept = sweep(VARIANTS, {"squares": squared}, workers=workers, progress=done.append)
    assert swept.rows == [{"variant": name, "square": k * k} for name, k in VARIANTS.items()]
    assert [step.done for step in done] == [1, 2, 3, 4, 5, 6]
    assert swept.status == "finished"


def test_a_measure_that_fails_leaves_a_note_and_the_others() -> None:
    swept = sweep(
        VARIANTS, {"squares": squared, "odds": odd_alone}, workers=2, progress=lambda step: None
    )
    assert [row.get("odd") for row in swept.rows] == [None, 1, None, 3, None, 5]
    assert swept.notes == [f"v{k}: odds failed: an even number diverges." for k in (0, 2, 4)]
    with pytest.raises(SsmrError, match="diverges"):
        sweep({"two": 2}, {"odds": odd_alone}, workers=1, progress=lambda step: None)


def test_an_interrupt_keeps_what_was_finished() -> None:
    def stop(step: Progress) -> None:
        if step.done == 2:
            raise KeyboardInterrupt

    swept = sweep(VARIANTS, {"squares": squared}, workers=1, progress=stop)
    assert swept.status == "interrupted"
    assert [row["variant"] for row in swept.rows] == ["v0", "v1"]
