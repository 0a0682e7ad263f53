"""The generator of made-up recordings: its laws in closed form, its noise, its strengths, and its second run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.fusion.coefficients import load_coefficients
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.records.datasets import read_data_sets
from gyrocal.records.run import read_run
from gyrocal.trial.conceal import Hidden, d_primes, error_dps, hide
from gyrocal.trial.disturbed import FLICKER_TAUS_S, Noise
from gyrocal.trial.gyros import Gyro, Oddity, make_gyro, surface_columns
from gyrocal.trial.laws import LAWS, OPEN_LOOP, OTHER, play
from gyrocal.trial.made_up import KINDS, MadeUp, Wish, make_up
from gyrocal.trial.plans import Bench, lagged
from gyrocal.trial.recordings import write_run
from gyrocal.trial.second import (
    Oracle,
    SecondRun,
    consult_oracle,
    corrected_rms_dps,
    inverted,
    second_run,
    share_removed,
)
from tests.trial.made_benches import small_run, small_table

QUIET = Noise(1e-9)
SAMPLE = Path(__file__).parents[2] / "sample_data" / "coefficients.json"


def gyro(noise: Noise = QUIET) -> Gyro:
    """A fibre gyro with a surface."""
    return replace(make_gyro("fog", Oddity(), np.random.default_rng(3)), noise=noise)


def column(name: str, bench: Bench, **parameters: float) -> np.ndarray:
    """Unit error of a law."""
    return LAWS[name].column(bench, parameters)


def test_lag_behind_a_ramp_is_the_ramp_times_tau() -> None:
    ramp = np.asarray(0.02 * np.arange(5000), dtype=np.float64)
    behind = ramp - lagged(ramp, 300.0)
    assert behind[-1] == pytest.approx(0.02 * 300.0, rel=2e-3)
    assert np.all(lagged(np.full(10, 7.0), 50.0) == pytest.approx(7.0))


def test_play_follows_with_its_slack() -> None:
    up_and_down = np.concatenate([np.linspace(0.0, 10.0, 50), np.linspace(10.0, 0.0, 50)])
    followed = play(up_and_down, 2.0)
    assert followed[49] == pytest.approx(8.0)
    assert followed[-1] == pytest.approx(2.0)


def test_laws_of_time_in_closed_form() -> None:
    bench = small_table()
    s = bench.t_s / bench.t_s[-1]
    two = column("warm_up_two", bench, fast_s=100.0, slow_s=2000.0, slow=0.25)
    assert two == pytest.approx(0.75 * np.exp(-bench.t_s / 100.0) + 0.25 * np.exp(-bench.t_s / 2000.0))
    assert column("warm_up_power", bench, t0_s=200.0, power=1.0) == pytest.approx(200.0 / (200.0 + bench.t_s))
    assert column("scale_ageing", bench, share=0.1) == pytest.approx(np.log1p(10.0 * s) * bench.rate_dps)
    assert set(column("bias_step", bench, at=0.5)) == {0.0, 1.0}


def test_laws_of_rate_in_closed_form() -> None:
    bench = small_table()
    lock = column("lock_in", replace(bench, rate_dps=np.array([0.05, 0.3, -0.5])), u=3e-3)
    assert lock == pytest.approx([-0.05, -0.3, -0.4 + 0.5], abs=1e-12)
    wide = column("asymmetry_soft", bench, u=1e-6)
    assert wide == pytest.approx(column("scale_asymmetry", bench), abs=1e-9)
    knee = column("knee_soft", bench, u=1.0)
    assert knee[bench.u == 1.0] == pytest.approx(2.0 ** (-1 / 6) - 1.0)
    sine = column("sagnac_sine", bench, reach=0.5)
    assert sine[bench.u == -1.0] == pytest.approx(100.0 - 200.0 * np.sin(0.5))


def test_error_of_each_rate_is_the_same_on_both_sides_and_in_every_sweep() -> None:
    bench = small_table(sets=116)
    relative = (column("reference_rate_error", bench, seed=5.0)[1:29]) / bench.rate_dps[1:29]
    assert relative[:14] == pytest.approx(relative[14:])
    assert np.unique(np.round(relative, 9)).size == 14


def test_angle_advances_by_what_the_table_turns() -> None:
    bench = small_run()
    for k in np.unique(bench.segment[bench.is_rate]):
        rows = bench.segment == k
        assert np.diff(bench.angle_deg[rows]) == pytest.approx(
            np.diff(bench.t_s[rows]) * bench.rate_dps[rows][0]
        )


@pytest.mark.parametrize("name", LAWS)
def test_every_law_draws_itself_and_has_a_name_of_the_catalogue(name: str) -> None:
    law = LAWS[name]
    p = law.draw(np.random.default_rng(1))
    assert p.keys() == law.ranges.keys()
    values = law.column(small_run(), p)
    assert np.isfinite(values).all()
    assert np.ptp(values) > 0 or law.low_rates
    assert set(law.right) <= set(CATALOGUE)


def test_whitening_is_that_of_the_dense_covariance() -> None:
    bench = small_table()
    noise = Noise(8e-3, flicker=1e-3, walk=4e-3, jitter=1e-4, grows=3.0)
    apart = np.abs(bench.t_s[:, None] - bench.t_s)
    cover = sum(1e-6 * np.exp(-apart / tau) for tau in FLICKER_TAUS_S)
    cover = cover + (4e-3**2 / 3600.0) * (np.minimum(bench.t_s[:, None], bench.t_s) - bench.t_s[0])
    cover += np.diag(noise.white_dps(bench) ** 2 + (1e-4 * bench.rate_dps) ** 2)
    x = np.random.default_rng(1).standard_normal((bench.t_s.size, 3))
    white = noise.whiten(bench, x)
    assert white.T @ white == pytest.approx(x.T @ np.linalg.solve(cover, x), rel=1e-9)


def test_rows_of_a_data_set_share_its_jitter() -> None:
    bench = small_run()
    noise = Noise(1e-3, jitter=1e-3)
    turning = np.unique(bench.segment[np.abs(bench.rate_dps) > 60.0])
    white = noise.whiten(bench, np.where(bench.segment == turning[0], bench.rate_dps, 0.0)[:, None])
    # 20 samples of white noise tell the mean to 0.7 mdps at 0.1 s each; the jitter of 100 mdps is what is left.
    assert np.linalg.norm(white) == pytest.approx(1e3, rel=1e-3)


def test_drawn_noise_is_white_once_whitened() -> None:
    bench = small_table(sets=400)
    noise = Noise(8e-3, flicker=3e-3, walk=1e-2, jitter=1e-4, grows=3.0)
    drawn = [noise.draw(bench, np.random.default_rng(k))[0] for k in range(20)]
    white = noise.whiten(bench, np.column_stack(drawn))
    assert np.var(white) == pytest.approx(1.0, abs=0.06)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.05


def test_strength_is_size_over_its_standard_error() -> None:
    """d' of the definition against the standard error of the amplitude in generalised least squares."""
    bench, noise = small_table(), Noise(8e-3, flicker=1e-3, jitter=3e-5)
    laws = [column("scale_step", bench, at=0.4), column("warm_up", bench, tau_s=500.0)]
    white = noise.whiten(bench, np.column_stack([surface_columns(bench, bench.temp_c), *laws]))
    beside, alone = d_primes(white, 12)
    scaled = np.linalg.norm(white, axis=0)
    covariance = np.linalg.inv((white / scaled).T @ (white / scaled)) / np.outer(scaled, scaled)
    assert beside == pytest.approx(1.0 / np.sqrt(np.diag(covariance)[12:]), rel=1e-6)
    assert np.all(alone >= beside)


def test_hidden_layers_have_the_strengths_that_were_drawn() -> None:
    bench, own = small_table(sets=171), gyro(Noise(8e-3, flicker=1e-3, jitter=3e-5))
    pool = [LAWS["scale_step"], LAWS["reference_rate_error"], LAWS["warm_up"]]
    hidden, layers = hide(bench, own, pool, 3, (40.0,), np.random.default_rng(2), given=[OPEN_LOOP])
    columns = [surface_columns(bench, bench.temp_c), *(h.amplitude * h.column(bench) for h in hidden)]
    white = own.noise.whiten(bench, np.column_stack(columns))
    beside, _ = d_primes(white, 12)
    assert beside == pytest.approx([a.d_prime_input for a in layers], rel=1e-6)
    assert beside[1:] == pytest.approx([40.0, 40.0], rel=1e-6)


def test_a_sine_is_stronger_against_a_surface_in_the_output() -> None:
    made = make_up("layers", 1, 0)
    sine = next(a for a in made.answer.layers if a.law == OPEN_LOOP.name)
    assert sine.d_prime > 2.0 * sine.d_prime_input


def second_of(first: Bench, hidden: list[Hidden], seed: int = 9) -> SecondRun:
    """Another plan for the same gyro."""
    return second_run(first, small_table(seed), gyro(), hidden)


def test_second_run_is_of_the_same_gyro_with_what_stays() -> None:
    first = small_table()
    stays = Hidden(LAWS["temperature_order"], {"scale": 1.0}, 0.01)
    goes = Hidden(LAWS["reference_rate_error"], {"seed": 4.0}, 1e-3)
    second = second_of(first, [stays, goes])
    expected = second.bench.rate_dps + error_dps(second.bench, gyro(), [stays])
    assert second.gyro_dps == pytest.approx(expected, abs=1e-12)
    assert np.any(error_dps(first, gyro(), [stays, goes]) != error_dps(first, gyro(), [stays]))


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_step_may_last_or_be_over(share: float) -> None:
    second = second_of(small_table(), [Hidden(LAWS["scale_step"], {"at": 0.5}, 1e-3)])
    lasted = second.bench.rate_dps * (1.0 - share * 1e-3)
    # The slope of the surface is of second order in it.
    assert second.rms_dps(lasted) < 1e-4
    assert second.rms_dps(second.bench.rate_dps + 0.5) > 0.1


def test_runs_are_judged_half_by_means_and_half_by_ramps_and_soaks() -> None:
    first = small_run()
    second = second_run(first, first, gyro(), [])
    off = np.where(first.is_rate, 3.0, 4.0)
    assert second.rms_dps(first.rate_dps + off) == pytest.approx(np.sqrt(0.5 * (9.0 + 16.0)))
    assert second.rms_dps(np.full(off.size, np.nan)) == float("inf")


def test_output_is_inverted_even_near_the_turn_of_the_sine() -> None:
    rate = np.linspace(-100.0, 100.0, 41)
    k = 1.5 / 100.0
    found = inverted(np.sin(k * rate) / k, 0.98 * rate, lambda w: np.sin(k * w) / k - w)
    assert found == pytest.approx(rate, abs=1e-6)


def test_oracle_removes_all_where_there_is_no_noise() -> None:
    first = small_table(sets=171)
    hidden = [
        Hidden(OPEN_LOOP, {"reach": 0.8}),
        Hidden(LAWS["coil_chain"], {"share": 0.8, "tau_s": 100.0}),
        Hidden(LAWS["warm_up_two"], {"fast_s": 200.0, "slow_s": 2000.0, "slow": 0.5}, 0.05),
    ]
    output = first.rate_dps + error_dps(first, gyro(), hidden)
    second = second_of(first, hidden)
    assert consult_oracle(first, output, second, gyro(), hidden).allowed_dps < 1e-8
    assert second.rms_dps(second.gyro_dps) > 0.05


def test_oracle_leaves_what_it_expects_to_leave() -> None:
    first, noise = small_table(sets=171), Noise(8e-3, flicker=1e-3, jitter=3e-5)
    own, hidden = gyro(noise), [Hidden(LAWS["warm_up"], {"tau_s": 500.0}, 0.05)]
    second = second_of(first, hidden)
    clean = first.rate_dps + error_dps(first, own, hidden)
    asked = [
        consult_oracle(first, clean + noise.draw(first, np.random.default_rng(k))[0], second, own, hidden)
        for k in range(40)
    ]
    left = np.sqrt(np.mean([o.rms_dps**2 for o in asked]))
    assert left == pytest.approx(asked[0].expected_dps, rel=0.3)


def test_share_of_the_removable_error() -> None:
    oracle = Oracle(2.0, 1.0)
    assert share_removed(10.0, 2.0, oracle) == 1.0
    assert share_removed(10.0, 14.0, oracle) == -0.5
    assert share_removed(10.0, None, oracle) == 0.0
    assert share_removed(2.2, 1.0, oracle) is None
    assert share_removed(10.0, 2.0, Oracle(2.0, 9.0)) is None


def test_correction_goes_through_apply(tmp_path: Path) -> None:
    made = next(m for m in (make_up("nulls", 1, k) for k in range(8)) if not m.bench.is_run)
    coefficients = load_coefficients(SAMPLE)
    by_hand = coefficients.correct(np.round(made.second.gyro_dps, 8), np.round(made.second.bench.temp_c, 4))
    through = corrected_rms_dps(made.write_second(tmp_path), made.second, coefficients)
    assert through == pytest.approx(made.second.rms_dps(by_hand), abs=1e-6)
    assert corrected_rms_dps(tmp_path, made.second, None) is None


def written(made: MadeUp, place: Path) -> dict[str, bytes]:
    """Every file of a recording and its second run."""
    place.mkdir()
    made.write(place)
    made.write_second(place)
    return {str(p.relative_to(place)): p.read_bytes() for p in sorted(place.rglob("*")) if p.is_file()}


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    a, b, c = make_up("layers", 5, 2), make_up("layers", 5, 2), make_up("layers", 5, 4)
    assert a.answer.text() == b.answer.text() != c.answer.text()
    assert written(a, tmp_path / "a") == written(b, tmp_path / "b")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_same_bytes_of_runs(kind: str, tmp_path: Path) -> None:
    assert written(make_up(kind, 5, 3), tmp_path / "a") == written(make_up(kind, 5, 3), tmp_path / "b")


def test_a_run_is_read_and_its_head_tells_nothing_of_what_is_hidden(tmp_path: Path) -> None:
    bench = small_run()
    run = read_run(write_run(tmp_path / "run", bench, gyro(), bench.rate_dps, bench.temp_c, "A1"))
    assert [r.kind for r in run.segments] == [s.kind for s in bench.segments]
    assert run.profile is None
    record = run.segments[-1]
    segment = run.segment(record)
    rows = bench.segment == len(run.segments) - 1
    assert segment.gyro_dps == pytest.approx(bench.rate_dps[rows])
    assert segment.table_rate_dps == pytest.approx(record.rate_dps)
    assert segment.table_angle_deg[0] == pytest.approx(bench.angle_deg[rows][0], abs=2.0)


def test_a_table_is_read(tmp_path: Path) -> None:
    made = make_up("layers", 1, 0)
    table = read_data_sets(made.write(tmp_path))
    assert table.gyro_dps == pytest.approx(made.gyro_dps, abs=1e-8)
    assert (table.t_s is not None) == made.told


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_wish_for_what_they_say(kind: str) -> None:
    def wish(number: int) -> Wish:
        return KINDS[kind](number, np.random.default_rng(1), np.random.default_rng(number))

    wishes = [wish(number) for number in range(24)]
    counts = {w.count for w in wishes}
    assert counts == {"layers": {3, 4, 5}, "laws": {1}, "sensors": {0, 1, 2}, "nulls": {0}}[kind]
    if kind == "layers":
        assert [w.plan == "table" for w in wishes[:4]] == [True, False, True, False]
    if kind == "laws":
        assert len({law.name for w in wishes for law in w.given}) == len(OTHER)
    if kind == "sensors":
        assert {w.make for w in wishes} == {"fog", "mems", "navigation"}
    if kind == "nulls":
        assert min(w.sets for w in wishes) < 40 < 300 <= max(w.sets for w in wishes) <= 600


def test_a_coarse_thermometer_reads_in_steps() -> None:
    coarse = replace(gyro(), thermometer_step_c=0.5)
    read = coarse.read_temperature(np.linspace(0.0, 3.0, 50), np.random.default_rng(1))
    assert read == pytest.approx(np.round(read * 2.0) / 2.0)


def test_a_step_that_lasts_is_free_at_rest_beside_truncation() -> None:
    """The error jumps at rest, by less than the step: what it moves is still about the step itself."""
    hidden = [Hidden(LAWS["bias_step"], {"at": 0.5}, 0.1), Hidden(LAWS["truncation"], {}, 0.003)]
    first = small_table(3)
    second = second_run(first, replace(first, rate_dps=np.zeros_like(first.rate_dps)), gyro(), hidden)
    np.testing.assert_allclose(second.open_dps[:, 0], 0.1, rtol=0.1)


def test_a_step_that_lasts_is_free_in_an_open_loop_too() -> None:
    """The slope of the output makes more of it, in the corrected rate, than was added to the output."""
    first = small_table()
    front = Hidden(OPEN_LOOP, {"reach": 1.2})
    second = second_of(first, [front, Hidden(LAWS["bias_step"], {"at": 0.5}, 1e-3)])
    own = gyro()

    def error(rate_dps: np.ndarray) -> np.ndarray:
        return error_dps(replace(second.bench, rate_dps=rate_dps), own, [front])

    lasted = inverted(second.gyro_dps - 1e-3, second.bench.rate_dps, error)
    assert np.abs(lasted - second.bench.rate_dps).max() > 2e-3
    assert second.rms_dps(lasted) < 2e-6


@pytest.mark.parametrize("lsb_dps", [0.004, 0.0122, 0.03])
def test_what_rounding_leaves_of_a_mean_is_what_the_whitening_allows_for(lsb_dps: float) -> None:
    stepped = make_gyro("fog", Oddity("", {"lsb_dps": lsb_dps}), np.random.default_rng(1))
    bench = replace(small_table(sets=2000), averaging_s=np.full(2000, 40.0))
    rates = np.random.default_rng(2).uniform(-1.0, 1.0, size=2000)
    left = np.std(stepped.read_rate(rates, bench, np.random.default_rng(3)) - rates)
    by_chance = lsb_dps / np.sqrt(12.0 * 400.0)
    assert left == pytest.approx(np.hypot(stepped.noise.steps, by_chance), rel=0.15)
