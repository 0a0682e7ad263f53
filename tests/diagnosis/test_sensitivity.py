"""The tables of what constants are worth, and what each is, speak of all constants as they are, and of none that is gone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.diagnosis.sensitivity import constants

TOLD = Path(__file__).with_name("sensitivity.md").read_text("utf-8")


def test_every_constant_was_measured() -> None:
    told = dict(re.findall(r"^\| `([^`]+:[^`]+)` \| ([-+.\de]+) \|", TOLD, re.M))
    assert told.keys() == {c.key for c in constants()}
    for constant in constants():
        assert float(told[constant.key]) == pytest.approx(constant.value, rel=1e-5), (
            f"{constant.key}: measure it anew"
        )


def test_of_every_constant_it_was_decided_what_it_is() -> None:
    rows = re.findall(r"^\| (law|rounding|cost|data|physics|price|gate) \| .* \| (`.*`) \|$", TOLD, re.M)
    told = [key for _, keys in rows for key in re.findall(r"`([^`]+)`", keys)]
    assert sorted(told) == sorted(c.key for c in constants())
    gates = re.findall(r"`([^`]+)`", next(keys for kind, keys in rows if kind == "gate"))
    why = re.findall(
        r"^\| `([^`]+:[^`]+)` \| [^|]+ \| [^|]+ \|$", TOLD.split("| gate | without it |")[1], re.M
    )
    assert sorted(why) == sorted(gates)
