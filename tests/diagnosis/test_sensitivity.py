"""The table of what constants are worth speaks of constants that there are."""

from __future__ import annotations

import re
from pathlib import Path

from tests.diagnosis.sensitivity import constants


def test_no_row_is_of_a_constant_that_is_gone() -> None:
    told = re.findall(
        r"^\| `([^`]+:[^`]+)` \|", Path(__file__).with_name("sensitivity.md").read_text("utf-8"), re.M
    )
    assert len(told) > 200
    assert set(told) <= {c.key for c in constants()}
