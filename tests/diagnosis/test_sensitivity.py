"""The table of what constants are worth speaks of all constants, and of none that is gone."""

from __future__ import annotations

import re
from pathlib import Path

from tests.diagnosis.sensitivity import constants


def test_every_constant_was_measured() -> None:
    told = re.findall(
        r"^\| `([^`]+:[^`]+)` \|", Path(__file__).with_name("sensitivity.md").read_text("utf-8"), re.M
    )
    assert set(told) == {c.key for c in constants()}
