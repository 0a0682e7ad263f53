"""The finder on concealed recordings: a few honest cases in the fast suite, a moderate score in the slow one.

Bounds of shares come from binomial distributions: a finder that is as good as its goal fails one test in a thousand.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from scipy import stats

from gyrocal.physics.catalogue import CATALOGUE
from tests.diagnosis.score import SINGLES, Case, cases, run_all, run_case
from tests.diagnosis.score_table import Outcome, format_table, wilson

FALSE_ALARM = 1e-3


def least_hits(goal: float, n: int) -> int:
    """Fewest hits in n trials that a true share of `goal` gives but for one time in a thousand."""
    return int(stats.binom.ppf(FALSE_ALARM, n, goal))


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        Case("null", (), 31, "even"),
        Case("single", (("supply_voltage", 20.0),), 32, "even"),
        Case("outside", (("three_per_rev", 20.0),), 33, "even"),
    ],
    ids=lambda c: c.key,
)
def test_honest_case(case: Case) -> None:
    outcome = run_case(case)
    if case.kind == "null":
        assert outcome.verdict == "consistent"
        assert outcome.named == []
    elif case.kind == "single":
        assert outcome.first_right
        assert outcome.gain_share is not None
        assert outcome.gain_share > 0.9
    else:
        assert outcome.outside_right


def test_cases_are_a_fair_sample_at_any_length() -> None:
    drawn = list(cases(60, 4))
    assert [c.key for c in drawn[:20]] == [c.key for c in cases(20, 4)]
    assert {c.kind for c in drawn[:20]} == {"null", "single", "pair", "outside", "level"}
    assert len({c.seed for c in drawn}) == 60
    assert set(SINGLES) <= set(CATALOGUE)


def _outcome(truth: list[str], named: list[str], d_prime: float = 20.0, kind: str = "single") -> Outcome:
    return Outcome("k", kind, truth, d_prime, "explained", named, named[:1], True, ["time"], False)


def test_table_counts_what_it_says() -> None:
    outcomes = [
        _outcome(["shupe"], ["shupe"]),
        _outcome(["shupe"], ["shupe_gradient"]),
        _outcome(["magnetic"], ["earth_rate_tilt"]),
        _outcome(["shupe", "warm_up"], ["warm_up", "shupe"], kind="pair"),
        _outcome([], [], kind="null"),
    ]
    text = format_table(outcomes)
    row = next(line for line in text.splitlines() if line.startswith("one, d' 20: right name first"))
    assert "2/3" in row
    assert "1/1" in next(line for line in text.splitlines() if line.startswith("two,"))
    assert "0/1" in next(line for line in text.splitlines() if line.startswith("nothing hidden: any"))
    assert "shupe_gradient (20) x1" in text


def test_wilson_interval_of_the_literature() -> None:
    """Newcombe 1998, table I, method 3."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)


@pytest.mark.slow
@pytest.mark.timeout(6 * 3600)
def test_score_reaches_its_goals(tmp_path: Path) -> None:
    outcomes = run_all(cases(120, 2026), tmp_path / "score.jsonl", say=False)
    table = format_table(outcomes)

    def hits(name: str, values: list[bool], goal: float) -> None:
        assert sum(values) >= least_hits(goal, len(values)), (
            f"{name}: {sum(values)} of {len(values)}\n{table}"
        )

    def at(*strengths: float) -> list[Outcome]:
        return [
            o
            for o in outcomes
            if o.kind == "single" and any(abs(o.d_prime - s) < 0.01 * s for s in strengths)
        ]

    hits("nothing named", [not o.named for o in outcomes if o.kind == "null"], 0.98)
    hits("d' 20 first", [o.first_right for o in at(20.0)], 0.97)
    hits("d' 12 first", [o.first_right for o in at(12.0)], 0.92)
    hits("d' 12 class", [o.class_right for o in at(12.0)], 0.98)
    hits("d' 8 first", [o.first_right for o in at(8.0)], 0.85)
    hits("d' 8 class", [o.class_right for o in at(8.0)], 0.95)
    hits("d' 8 family", [o.family_right for o in at(8.0)], 0.98)
    hits("pairs", [o.exact for o in outcomes if o.kind == "pair"], 0.88)
    hits("outside", [o.outside_right for o in outcomes if o.kind == "outside"], 0.80)
    hits("strong", [len(o.named) <= 1 for o in at(100.0, 300.0)], 0.95)
    hits("coverage", [c for o in outcomes for c in o.covered.values()], 0.92)
