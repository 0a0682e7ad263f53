"""What a simulation lacks is named and brings it nearer, on pairs that were made up without the catalogue."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tests.diagnosis.versus.pairs import answer, judged, make_pair


def test_a_hidden_asymmetry_is_named_and_told_in_its_unit() -> None:
    pair = make_pair(2)
    assert list(pair.hidden) == ["scale_asymmetry"]
    found = answer(pair, heldout=False)
    assert [e.effect for e in found.diagnosis.effects] == ["scale_asymmetry"]
    # Its rates are drawn anew at each temperature, here and there.
    assert not found.match.in_order
    assert found.match.matched_sets == found.match.sets


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_most_are_named_and_few_are_wrong() -> None:
    """Of 24 pairs: names in four of five, one of ten wrong, by one-sided bounds of 1 %."""
    right: list[bool] = []
    wrong: list[bool] = []
    nearer: list[bool] = []
    for seed in range(1, 25):
        pair = make_pair(seed)
        found = answer(pair)
        named, false = judged(pair, found)
        right += named
        wrong += false
        nearer.append(found.helps)
    assert np.sum(right) >= stats.binom.ppf(0.01, len(right), 0.8)
    assert np.sum(wrong) <= stats.binom.ppf(0.99, len(wrong), 0.1)
    assert np.sum(nearer) >= stats.binom.ppf(0.01, len(nearer), 0.85)
