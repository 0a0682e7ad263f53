"""Words of the reasons why a record cannot show an effect."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.lacking import Lack, Reason, Why
from gyrocal.physics.offer import Offer
from gyrocal.report.reasons import WORDS, reason_words
from tests.physics.test_search import WHOLE


def test_every_reason_has_words() -> None:
    assert set(WORDS) == set(Why)


@pytest.mark.parametrize(
    ("effect", "offer", "words"),
    [
        ("scale_asymmetry", replace(WHOLE, rates_dps=WHOLE.rates_dps[:3]), "it has 3 different rates, and shapes in rate need"),
        ("shupe", replace(WHOLE, temp_c=(20.0, 21.0)), "the temperature changed by less than 2 degC"),
        ("warm_up", replace(WHOLE, since_power_on_s=6000.0), "the record begins more than 1.5 h after power-on"),
        ("supply_voltage", replace(WHOLE, channels=WHOLE.channels - {"supply_v"}), "the record has no supply_v"),
    ],
)  # fmt: skip
def test_a_reason_has_its_facts(effect: str, offer: Offer, words: str) -> None:
    reason = find_effect(effect).why_not(offer)
    assert reason is not None
    assert reason_words(reason).startswith(words)


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        (Lack(Why.LIKE_WAY), "without true positions it cannot be told from the true way"),
        (Lack(Why.POOR_TRUTH, {"percent": 3.14}), "with this truth it is known to 3.1 % only"),
        ("nobody looked", "nobody looked"),
    ],
)  # fmt: skip
def test_reasons_in_words(reason: Reason, words: str) -> None:
    assert reason_words(reason) == words
