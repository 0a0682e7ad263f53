"""What earns its place in the improved coefficients."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from gyrocal.diagnosis.correction import doubtful
from gyrocal.diagnosis.examine import Examination


def _found(nats: float, named: str = "", candidates: tuple[Any, ...] = ()) -> Examination:
    naming = SimpleNamespace(named=[SimpleNamespace(block=named)], unnamed={"memory": nats})
    return cast(Examination, SimpleNamespace(candidates=candidates, naming=naming))


def _left_out(low: float) -> Any:
    return {"memory": SimpleNamespace(logloss_interval_95=(low, 0.1))}


@pytest.mark.parametrize(
    ("found", "low", "expected"),
    [
        (_found(7.0), -0.01, ["memory"]),
        (_found(7.0), 0.01, []),
        (_found(30.0), -0.01, []),
        (_found(7.0, named="memory"), -0.01, []),
        (_found(7.0, candidates=((1.0, None),)), -0.01, []),
    ],
)
def test_a_weak_part_must_predict_what_was_left_out(
    found: Examination, low: float, expected: list[str]
) -> None:
    assert doubtful(found, _left_out(low)) == expected


def test_a_weak_part_that_nothing_was_left_out_for_is_not_written() -> None:
    assert doubtful(_found(7.0), {}) == ["memory"]
