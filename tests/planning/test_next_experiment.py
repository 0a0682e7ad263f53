"""The plan that separates two effects: its arithmetic, and that what it proposes is a sound profile."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from gyrocal.bench.profile import load_profile, parse_profile, profile_from_dict
from gyrocal.bench.session import AcquireConfig, connect, dry_run, plan_of
from gyrocal.cli.acquire import command as acquire_command
from gyrocal.diagnosis.result import Alternative, Diagnosis, Estimate, Located
from gyrocal.fusion.coefficients import Valid
from gyrocal.inference.gram import Projection
from gyrocal.planning.next_experiment import _reach, propose, to_toml
from gyrocal.planning.planned import Reach, designs, duration_h, planned_series, to_profile
from gyrocal.planning.separation import Separation, _against_draws, power_of, repeats_needed, separate
from tests.diagnosis.concealed_bench import make_recording
from tests.diagnosis.made_up import made_up_diagnosis

REACH = Reach(100.0, -10.0, 50.0, 2.0, 4.0)
SENSOR = {
    "model": "RD2100-class",
    "sample_rate_hz": 10.0,
    "rate_range_dps": [-100, 100],
    "temp_range_c": [-40, 75],
}


@cache
def made_up(effect: str | None, d_prime: float) -> Diagnosis:
    """The true answer of a recording with one effect, or with none."""
    return made_up_diagnosis(make_recording([] if effect is None else [(effect, d_prime)], 7, "even"))


def doubtful(effect: str, *others: str, d_prime: float = 8.0) -> Diagnosis:
    """A diagnosis that cannot tell `effect` from `others`."""
    found = made_up(effect, d_prime)
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
        ("warm_up", ("bias_drift",), 8.0, "power-on"),
        ("dead_zone", ("truncation",), 1.5, "rates"),
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
    assert proposal.expected_power > 0.85
    assert plan in proposal.sentence
    assert proposal.separates == (effect, *others)


def test_a_plan_must_tell_the_two_whichever_is_true() -> None:
    """A warm-up is seen from power-on alone, be it the one that is named or the other."""
    chosen = []
    for named, other in (("warm_up", "bias_drift"), ("bias_drift", "warm_up")):
        found = doubtful(named, other, d_prime=12.0)
        designs_of = {d.name: d for d in designs(REACH)}
        on, rest = (
            separate(found, found.effects[0], [other], designs_of[n], REACH)[0]
            for n in ("power_on_long", "rest_long")
        )
        assert on.if_other is not None
        assert rest.if_other is not None
        seen = [
            (x if named == "warm_up" else y).d_prime for x, y in ((on, on.if_other), (rest, rest.if_other))
        ]
        assert seen[0] > 1.5 * seen[1]
        assert on.expected_power == pytest.approx((3.0 * on.power + on.if_other.power) / 4.0)
        chosen.append(on.expected_power > rest.expected_power)
    assert chosen == [True, True]


def test_no_doubt_no_experiment() -> None:
    found = made_up("shupe", 12.0)
    settled = replace(found, effects=(replace(found.effects[0], alternatives=()),))
    assert propose(settled, {}, 8.0) is None


def test_twins_on_a_table_need_a_hand() -> None:
    proposal = propose(doubtful("earth_rate_tilt", "magnetic", "g_sensitivity"), {}, 8.0)
    assert proposal is not None
    assert proposal.profile is None
    assert "tilt the table" in proposal.sentence


def test_unexplained_structure_gets_a_plan_that_resolves_its_coordinate() -> None:
    found = made_up(None, 0.0)
    place = Located("temperature", "mean", 1e-9, 0.9, remains=True)
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


WARM = replace(REACH, low_c=39.0, high_c=47.0, rest_c=40.0)
#: A sound record, one of a static log, one at a single temperature far from a room's, one of a fast gyro.
REACHES = {
    "wide": REACH,
    "warm": WARM,
    "static": replace(WARM, rate_dps=0.0, sizes_dps=(0.0,)),
    "one temperature": replace(REACH, low_c=60.4, high_c=60.4, rest_c=60.0),
    "fast": replace(REACH, rate_dps=900.0, sizes_dps=tuple(np.linspace(0, 900, 13).tolist())),
    "slow": replace(REACH, rate_dps=0.42),
}


@pytest.mark.parametrize("reach", REACHES.values(), ids=REACHES)
def test_acquire_takes_every_plan(reach: Reach, tmp_path: Path) -> None:
    """As a user would: the file, dry, on the bench that the profile names."""
    for design in designs(reach):
        path = tmp_path / "next_experiment.toml"
        path.write_text(to_toml(to_profile(design, reach, {}, {})))
        profile, plan = dry_run(AcquireConfig(path, Path()))
        rates = {step.rate_dps for step in plan.steps}
        assert max(map(abs, rates)) <= reach.rate_dps
        assert reach.low_c - 1 <= profile.safe.chamber_c <= reach.high_c
        # Late at every step it does not take days.
        assert plan.latest_s < 4.0 * plan.expected_s + 7200.0


def test_the_command_line_takes_a_plan(tmp_path: Path) -> None:
    path = tmp_path / "next_experiment.toml"
    path.write_text(to_toml(to_profile(designs(WARM)[0], WARM, {}, {})))
    result = CliRunner().invoke(acquire_command, [str(path), "--dry-run"])
    assert result.exit_code == 0, result.output


def at_rates(
    found: Diagnosis, rates: np.ndarray, temp_c: tuple[float, float], sensor: dict[str, Any]
) -> Diagnosis:
    """The same diagnosis of a record at other rates and temperatures."""
    assert found.rows is not None
    assert found.surface is not None
    full = float(np.max(np.abs(rates)))
    surface = replace(found.surface, sensor=sensor, valid=Valid((-full, full), temp_c))
    picked = np.resize(rates, found.rows.rate_dps.size)
    temps = np.full(picked.size, temp_c[0] + 1.0)
    return replace(found, surface=surface, rows=replace(found.rows, rate_dps=picked, temp_c=temps))


UNEXPLAINED = Located("time", "mean", 1e-9, 0.9, remains=True)


@pytest.mark.parametrize("coordinate", ["rate", "time", "temperature", "temperature_rate", "data_set_index"])
def test_a_log_at_one_rate_gets_a_plan_at_rest(coordinate: str, tmp_path: Path) -> None:
    """Nothing is known of what rates such a gyro bears."""
    base = replace(made_up(None, 0.0), verdict="unexplained")
    place = replace(UNEXPLAINED, coordinate=coordinate)
    found = at_rates(replace(base, located=(place,)), np.zeros(1), (3.0, 48.0), {"model": "unknown"})
    proposal = propose(found, {}, 8.0)
    if coordinate == "rate":
        assert proposal is None
        return
    assert proposal is not None
    assert proposal.profile is not None
    path = tmp_path / "next_experiment.toml"
    path.write_text(to_toml(proposal.profile))
    _, plan = dry_run(AcquireConfig(path, Path()))
    assert {step.rate_dps for step in plan.steps} == {0.0}
    assert "the table stands" in proposal.sentence
    assert plan.expected_s < 8.0 * 3600.0


def test_a_plan_stays_within_what_the_gyro_and_the_user_allow() -> None:
    base = replace(made_up(None, 0.0), verdict="unexplained")
    sensor = {"model": "x", "rate_range_dps": [-90.0, 90.0], "temp_range_c": [0.0, 40.0]}
    found = at_rates(
        replace(base, located=(replace(UNEXPLAINED, coordinate="rate"),)),
        np.linspace(-100, 100, 11),
        (-10.0, 50.0),
        sensor,
    )
    limits = {"max_rate_dps": 80.0, "min_temp_c": 10.0}
    proposal = propose(found, {"limits": limits}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    assert max(proposal.profile["plan"]["rates_dps"]) == 80.0
    assert all(10.0 <= t <= 40.0 for t in proposal.profile["plan"]["temperatures_c"])
    dry = profile_from_dict(proposal.profile, "next_experiment.toml")
    plan_of(dry, connect(dry, simulate=True)[0])


def saturating(d_prime: float) -> Diagnosis:
    """Saturation or the reference, of a strength that fine rates would see with `d_prime`."""
    found = doubtful("saturation", "reference_rate_error")
    effect, fine = found.effects[0], next(d for d in designs(REACH) if d.name == "fine_rates")
    size = effect.parameters["amplitude"]
    now = separate(found, effect, ["reference_rate_error"], fine, REACH)[0].d_prime
    sized = {**effect.parameters, "amplitude": replace(size, value=size.value * d_prime / now)}
    return replace(found, effects=(replace(effect, parameters=sized),))


def test_two_shapes_of_rate_are_told_apart_by_more_rates_not_by_ramps() -> None:
    """An error of the reference is drawn anew for each rate, a law is smooth: what ramps at rest tell is nothing."""
    found = saturating(25.0)
    proposal = propose(found, {}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    assert len(proposal.profile["plan"]["rates_dps"]) >= 5
    assert proposal.expected_power is not None
    assert proposal.expected_power > 0.85
    few, many = (
        separate(found, found.effects[0], ["reference_rate_error"], d, REACH)[0]
        for d in (next(d for d in designs(REACH) if d.name == n) for n in ("repeats", "fine_rates"))
    )
    assert few.power < 0.5 < 0.99 < many.power


def test_power_against_draws_is_that_of_their_evidence() -> None:
    """Monte Carlo: a law over K rates against K draws of one size, by the marginal likelihood of either."""
    rng = np.random.default_rng(5)
    k, d_prime, trials = 12, 7.0, 4000
    law = np.sqrt(np.arange(1.0, k + 1))
    law *= d_prime / np.linalg.norm(law)
    left = Projection(np.eye(k), law, np.ones(k), d_prime**2)
    told = _against_draws("reference_rate_error", d_prime, left, np.arange(k))
    y = law + rng.standard_normal((trials, k))
    sizes = np.geomspace(1e-2, 1e2, 200)[:, None, None]
    marginal = 0.5 * np.sum(y**2 * sizes**2 / (1 + sizes**2) - np.log1p(sizes**2), axis=2).max(axis=0)
    share = np.mean(0.5 * (y @ law / d_prime) ** 2 - np.maximum(marginal, 0.0) > 3.0)
    assert told.power == pytest.approx(share, abs=0.1)


def test_what_nothing_in_reach_settles_gets_no_profile() -> None:
    """A tiny law that draws can follow: no plan, and the sentence says so."""
    proposal = propose(saturating(0.3), {}, 2.0)
    assert proposal is not None
    assert proposal.profile is None
    assert "no plan within 2 h of bench time separates them" in proposal.sentence


def test_planned_rows_are_those_of_a_run() -> None:
    series = planned_series(next(d for d in designs(REACH) if d.name == "levels"), REACH, 1.4e-3)
    assert np.all(np.diff(series.t_s) > 0)
    assert series.temp_c.min() > REACH.low_c - 1
    assert series.temp_c.max() < REACH.high_c + 1
    assert set(np.unique(series.rate_dps)) == {-50.0, 0.0, 50.0}
    ks = stats.spearmanr(series.temp_rate_c_per_min, np.gradient(series.temp_c, series.t_s)).statistic
    assert ks > 0.9


def test_a_doubt_near_zero_gets_rates_where_it_lives() -> None:
    """A dead zone of 0.08 deg/s had been looked for from 0.5 deg/s on."""
    found = doubtful("dead_zone", "truncation", d_prime=12.0)
    effect = found.effects[0]
    width = Estimate.normal(0.08, 0.01, "deg/s")
    zone = replace(effect, parameters={**effect.parameters, "width_dps": width})
    reach = _reach(replace(found, effects=(zone,)), SENSOR, {})
    assert reach.near_dps == 0.08
    rates = next(d for d in designs(reach) if d.name == "near_zero").rates_dps
    assert sum(r <= 0.16 for r in rates) == 8
    assert max(rates) == reach.rate_dps


def test_what_is_left_near_zero_is_looked_for_there() -> None:
    base = replace(made_up(None, 0.0), verdict="unexplained")
    left = Located("rate", "mean", 1e-9, 0.9, remains=True, low=-0.1, high=0.1, unit="deg/s")
    sensor = {"model": "x", "rate_range_dps": [-100.0, 100.0]}
    rates = np.array([-100.0, -10.0, -0.1, 0.0, 0.1, 10.0, 100.0])
    found = at_rates(replace(base, located=(left,)), rates, (10.0, 30.0), sensor)
    proposal = propose(found, {}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    assert "rates dense near zero, 6 times at one temperature" in proposal.sentence
    assert sum(r <= 0.2 for r in proposal.profile["plan"]["rates_dps"]) == 8
    wide = replace(left, low=-60.0, high=60.0)
    proposal = propose(replace(found, located=(wide,)), {}, 8.0)
    assert proposal is not None
    assert "fine rates" in proposal.sentence


def test_a_doubt_about_time_gets_no_rates_dense_near_zero() -> None:
    """A jump or a drift of the scale factor had been looked for with rates from 0.5 deg/s on."""
    proposal = propose(doubtful("scale_step", "scale_drift", d_prime=12.0), {}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    assert "near zero" not in proposal.sentence
    assert max(proposal.profile["plan"]["rates_dps"]) >= 50.0
    assert len(proposal.profile["plan"]["rates_dps"]) <= 10


def test_a_plan_is_no_coarser_than_the_record_and_has_the_rates_at_issue() -> None:
    """Steps of 5 deg/s had been proposed after a record in steps of 3.6 of which 32.4 was odd."""
    base = replace(made_up(None, 0.0), verdict="unexplained")
    odd = Located("rate", "variance", 1e-7, 0.6, remains=True, low=32.4, high=32.4, unit="deg/s")
    sensor = {"model": "x", "rate_range_dps": [-101.0, 101.0]}
    sizes = 3.6 * np.arange(29)
    record = np.concatenate([-sizes, sizes, sizes * 1.0002])
    found = at_rates(replace(base, located=(odd,)), record, (10.0, 30.0), sensor)
    proposal = propose(found, {}, 8.0)
    assert proposal is not None
    assert proposal.profile is not None
    rates = np.array(proposal.profile["plan"]["rates_dps"])
    assert all(np.abs(rates / size - 1.0).min() < 1e-3 for size in sizes[1:-1])
    assert np.diff(rates).max() < 3.61
    assert {30.6, 34.2} <= {round(r, 1) for r in rates}
    assert 30 <= rates.size <= 34


def test_a_plan_after_a_coarse_record_fills_its_rates() -> None:
    reach = replace(REACH, sizes_dps=(0.0, 2.0, 50.0, 99.999))
    fine = next(d for d in designs(reach) if d.name == "fine_rates").rates_dps
    assert {2.0, 50.0} <= set(fine)
    assert max(fine) == pytest.approx(100.0, abs=0.01)
    assert np.diff(fine).max() <= 5.0
