"""Models of a table that are as good as one another are averaged by their evidence."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from gyrocal.diagnosis.coil import AVERAGED_NATS, Candidate, averaged


def test_models_weigh_by_their_evidence_and_far_ones_not_at_all() -> None:
    scores = [10.0, 10.5, 13.0, 10.0 + AVERAGED_NATS + 0.1]
    found = averaged([Candidate(None, (), cast(Any, None), score) for score in scores])
    assert [c.score for _, c in found] == scores[:3]
    expected = np.exp([0.0, -0.5, -3.0])
    assert [w for w, _ in found] == pytest.approx((expected / expected.sum()).tolist())
