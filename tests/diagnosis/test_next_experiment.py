"""The plan that separates two effects: its arithmetic, and that what it proposes is a sound profile."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from gyrocal.bench.profile import load_profile, parse_profile, profile_from_dict
from gyrocal.bench.session import connect, plan_of
from gyrocal.diagnosis.next_experiment import (
    Separation,
    power_of,
    propose,
    repeats_needed,
    separate,
    to_toml,
)
from gyrocal.diagnosis.planned import Reach, designs, duration_h, planned_series, to_profile
from gyrocal.diagnosis.result import Alternative, Diagnosis, Located
from tests.diagnosis.concealed_bench import make_recording
from tests.diagnosis.made_up import made_up_diagnosis

REACH = Reach(100.0, -10.0, 50.0, 2.0, 4.0)
SENSOR = {
    "model": "RD2100-class",
    "sample_rate_hz": 10.0,
    "rate_range_dps": [-100, 100],
    "temp_range_c": [-40, 75],
}


def doubtful(effect: str, *others: str, d_prime: float = 8.0) -> Diagnosis:
    """A diagnosis that cannot tell `effect` from `others`."""
    found = made_up_diagnosis(make_recording([(effect, d_prime)], 7, "even"))
    named = replace(found.effects[0], alternatives=tuple(Alternative(o, 3.0) for o in others))
    return replace(found, effects=(named,))


def test_power_is_the_tail_of_the_log_likelihood_ratio() -> None:
    """Monte Carlo of the ratio of two known signatures in white noise, 3 sigma of its own count."""
    rng = np.random.default_rng(3)
    n, d_prime, captured, trials = 40, 5.0, 0.6, 20_000
    a = np.zeros(n)
    a[0] = d_prime
    along_b = np.zeros(n)
    along_b[0], along_b[1] = np.sqrt(captured), np.sqrt(1 - captured)
    y = a + rng.normal(size=(trials, n))
    # Both sizes are estimated, so each side gains its own chi-square: half of its square.
    ratio = 0.5 * ((y @ a / d_prime) ** 2 - (y @ along_b) ** 2)
    share = np.mean(ratio > 3.0)
    assert power_of(d_prime, captured) == pytest.approx(share, abs=0.04)


def test_d_prime_needed_is_the_reports_rule() -> None:
    assert Separation("x", 1.0, 0.95, 0.0).d_prime_needed == pytest.approx(10.95, abs=0.01)


def test_repeats_reach_the_power_that_is_asked_for() -> None:
    one = Separation("x", 3.0, 0.5, power_of(3.0, 0.5))
    times = repeats_needed([one])
    assert power_of(3.0 * np.sqrt(times), 0.5) >= 0.95 > power_of(3.0 * np.sqrt(times - 1), 0.5)


def test_longer_record_sees_more() -> None:
    found = doubtful("bias_drift", "warm_up")
    short, long = (next(d for d in designs(REACH) if d.name == n) for n in ("turns", "levels"))
    (a,), (b,) = (separate(found, found.effects[0], ["warm_up"], d, REACH) for d in (short, long))
    assert b.d_prime > 2 * a.d_prime


@pytest.mark.parametrize(
    ("effect", "others", "hours", "plan"),
    [
        ("warm_up", ("bias_drift",), 4.2, "power-on"),
        ("dead_zone", ("truncation",), 1.5, "zero"),
        ("reference_rate_error", ("rate_order",), 1.5, "rates"),
    ],
)
def test_doubt_gets_the_plan_that_settles_it(
    effect: str, others: tuple[str, ...], hours: float, plan: str
) -> None:
    proposal = propose(doubtful(effect, *others, d_prime=12.0), {}, hours)
    assert proposal is not None
    assert proposal.profile is not None
    assert proposal.expected_power is not None
    assert proposal.expected_power > 0.9
    assert plan in proposal.sentence
    assert proposal.separates == (effect, *others)


def test_no_doubt_no_experiment() -> None:
    found = made_up_diagnosis(make_recording([("shupe", 12.0)], 7, "even"))
    settled = replace(found, effects=(replace(found.effects[0], alternatives=()),))
    assert propose(settled, {}, 8.0) is None


def test_twins_on_a_table_need_a_hand() -> None:
    proposal = propose(doubtful("earth_rate_tilt", "magnetic", "g_sensitivity"), {}, 8.0)
    assert proposal is not None
    assert proposal.profile is None
    assert "tilt the table" in proposal.sentence


def test_unexplained_structure_gets_a_plan_that_resolves_its_coordinate() -> None:
    found = made_up_diagnosis(make_recording([], 7, "even"), "unexplained")
    place = Located("temperature", "mean", "20 to 30 degC", 1e-9, 0.9, remains=True)
    proposal = propose(replace(found, verdict="unexplained", located=(place,)), {}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    assert len(proposal.profile["plan"]["temperatures_c"]) > 7


def test_too_little_bench_time_says_so() -> None:
    proposal = propose(doubtful("warm_up", "bias_drift"), {}, 0.1)
    assert proposal is not None
    assert proposal.profile is None
    assert "0.1 h" in proposal.sentence


@pytest.mark.parametrize("design", designs(REACH), ids=lambda d: d.name)
def test_every_design_is_a_profile_that_the_bench_can_run(design: Any) -> None:
    quick = load_profile("quick")
    raw = to_profile(design, REACH, SENSOR, dict(quick.raw))
    profile = parse_profile(to_toml(raw), "next_experiment.toml")
    assert profile == profile_from_dict(raw, "next_experiment.toml")
    plan = plan_of(profile, connect(profile, simulate=True)[0])
    # The bench brings the table to rate more slowly than the design assumes, and starts from another temperature.
    assert plan.expected_s / 3600 == pytest.approx(duration_h(design, REACH), rel=0.25)


def test_planned_rows_are_those_of_a_run() -> None:
    series = planned_series(designs(REACH)[-1], REACH, 1.4e-3)
    assert np.all(np.diff(series.t_s) > 0)
    assert series.temp_c.min() > REACH.low_c - 1
    assert series.temp_c.max() < REACH.high_c + 1
    assert set(np.unique(series.rate_dps)) == {-50.0, 0.0, 50.0}
    ks = stats.spearmanr(series.temp_rate_c_per_min, np.gradient(series.temp_c, series.t_s)).statistic
    assert ks > 0.9
