"""Each law against numbers worked out by hand, and the recursions against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrocal.physics import kernels
from gyrocal.physics.catalogue import CATALOGUE, find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Floats
from gyrocal.physics.kernels import lag, normal, play, uniform
from gyrocal.physics.surface import Direction, Surface

SURFACE = Surface(
    np.array([[0.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [-0.5, 0.0, 0.0]]), 0, 100, 20, 30
)


def error(effect_id: str, c: Conditions, surface: Surface | None = None, **p: float) -> Floats:
    effect = find_effect(effect_id)
    return effect.error_dps(c, effect.complete(p), surface, None)[0]


def at(rate: Floats | list[float], **channels: Floats) -> Conditions:
    n = len(rate)
    bare = Conditions(np.arange(n, dtype=np.float64), np.asarray(rate, dtype=np.float64), np.full(n, 20.0))
    given: dict[str, Any] = dict(channels)
    return replace(bare, **given)


@pytest.mark.parametrize("direction", ["output", "input"])
@pytest.mark.parametrize("effect_id", sorted(e.id for e in CATALOGUE.values() if e.runtime))
def test_how_a_law_goes_with_the_surface_is_what_it_says(effect_id: str, direction: Direction) -> None:
    """By differences; what says nothing does not go with it."""
    effect, n = find_effect(effect_id), 40
    t = 30.0 * np.arange(n, dtype=np.float64)
    c = Conditions(t, 90.0 * np.cos(t), 20.0 + t / 60.0, since_power_on_s=t, supply_v=12.0 + 0.01 * np.sin(t))
    p = effect.complete({"amplitude": 0.5 * effect.parameter("amplitude").typical})
    surface = replace(SURFACE, direction=direction)
    first = effect.error_dps(c, p, surface, None)[0]
    said = np.zeros((n, 12)) if effect.by_surface is None else effect.by_surface(c, p, surface, None)
    for k in range(12):
        more: Floats = surface.coefficients_dps.copy()
        more.ravel()[k] += 1e-3
        moved = effect.error_dps(c, p, replace(surface, coefficients_dps=more), None)[0]
        # Where it goes by the output, the surface moves that too, by a few percent of the slope.
        np.testing.assert_allclose((moved - first) / 1e-3, said[:, k], atol=0.05 * np.abs(said).max() + 1e-9)


def test_lag_of_a_ramp_is_exact_at_any_spacing() -> None:
    tau, slope = 300.0, 0.025
    for step in (0.1, 7.0, 900.0):
        t = np.arange(0.0, 3000.0, step)
        behind, _ = lag(t, 20.0 + slope * t, tau, None)
        np.testing.assert_allclose(behind, slope * tau * (1 - np.exp(-t / tau)), atol=1e-12)


def test_lag_passes_over_nan_and_takes_a_jump_at_once() -> None:
    t = np.array([0.0, 1.0, 1.0, 2.0])
    behind, memory = lag(t, np.array([5.0, np.nan, 6.0, 6.0]), 10.0, None)
    mean = -np.expm1(-0.1) / 0.1
    np.testing.assert_allclose(behind, [0.0, np.nan, mean, mean * np.exp(-0.1)])
    jump, _ = lag(np.array([2.0]), np.array([8.0]), 10.0, memory)
    assert jump[0] == pytest.approx(behind[-1] + 2.0)
    assert lag(t[:1], np.array([np.nan]), 10.0, None)[1] is None


def test_compiled_loops_give_the_same_numbers_as_python(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")  # imported now, so that long blocks run compiled
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.random(5000))
    x = np.cumsum(rng.normal(size=5000))
    x[7] = np.nan
    fast = lag(t, x, 40.0, None), play(x, 3.0, None)
    monkeypatch.setattr(kernels, "compiled", lambda function: function)
    slow = lag(t, x, 40.0, None), play(x, 3.0, None)
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1] == b[1]


def test_play_follows_the_branches() -> None:
    up_down = np.array([0.0, 5.0, 20.0, 12.0, 9.0, 0.0])
    position, last = play(up_down, 5.0, None)
    np.testing.assert_array_equal(position, [0, 0, 15, 15, 14, 5])
    assert last == 5.0


def test_draws_are_uniform_normal_and_repeatable() -> None:
    keys = np.arange(-20_000.0, 20_000.0)
    u, z = uniform(7, 1, keys), normal(7, 1, keys)
    # Kolmogorov's bound at a false-alarm rate of 1e-6: 2.69 / sqrt(n).
    grid = (np.arange(u.size) + 0.5) / u.size
    assert np.max(np.abs(np.sort(u) - grid)) < 2.69 / np.sqrt(u.size)
    assert abs(z.mean()) < 4.9 / np.sqrt(z.size)
    assert abs(z.var() - 1) < 4.9 * np.sqrt(2 / z.size)
    np.testing.assert_array_equal(normal(7, 1, keys[::-1]), z[::-1])
    assert abs(np.corrcoef(z, normal(8, 1, keys))[0, 1]) < 4.9 / np.sqrt(z.size)
    assert abs(np.corrcoef(z, normal(7, 2, keys))[0, 1]) < 4.9 / np.sqrt(z.size)


def test_shupe_on_a_ramp_and_with_a_stated_temperature_rate() -> None:
    t = np.arange(0.0, 600.0)
    ramp = at(np.zeros(600), t_s=t, temp_c=20 + 1.5 / 60 * t)
    assert error("shupe", ramp, amplitude=2.0)[-1] == pytest.approx(3e-3, rel=1e-6)
    stated = at([0.0, 0.0], temp_rate_c_per_s=np.array([1.5 / 60, -0.5 / 60]))
    np.testing.assert_allclose(error("shupe", stated, amplitude=2.0), [3e-3, -1e-3])


def test_thermal_lag_moves_bias_and_scale_together() -> None:
    t = np.arange(0.0, 6000.0, 10.0)
    slope, tau = 0.01, 200.0
    for rate in (0.0, 80.0):
        c = at(np.full(t.size, rate), t_s=t, temp_c=slope * t)
        last = error("thermal_lag", c, SURFACE, amplitude=1.0, tau_s=tau)[-1]
        output = rate + float(SURFACE.error_dps(rate, c.temp_c[-1]))
        behind = slope * tau / 30.0
        assert last == pytest.approx(-behind * (0.3 + output / 100.0), rel=1e-6)


def test_laws_by_hand() -> None:
    assert error("warm_up", at([0.0], since_power_on_s=np.array([600.0])), amplitude=10.0, tau_s=600.0)[
        0
    ] == pytest.approx(10e-3 / np.e)
    t = np.array([0.0, 3600.0, 7200.0])
    np.testing.assert_allclose(error("bias_drift", at([0.0] * 3, t_s=t), amplitude=2.0), [0, 2e-3, 4e-3])
    np.testing.assert_allclose(
        error("bias_drift", at([0.0] * 3, t_s=t), amplitude=2.0, power=0.5), [0, 2e-3, 2e-3 * np.sqrt(2.0)]
    )
    # Ageing: with the logarithm of time, whatever the power, and as large after an hour.
    aged = error("bias_drift", at([0.0] * 3, t_s=t), amplitude=2.0, power=0.5, knee_s=1200.0)
    np.testing.assert_allclose(aged, [0, 2e-3, 2e-3 * np.log(7.0) / np.log(4.0)])
    late = error("bias_drift", at([0.0] * 3, t_s=t), amplitude=2.0, knee_s=1e7)
    np.testing.assert_allclose(late, [0, 2e-3, 4e-3], rtol=1e-3)
    np.testing.assert_allclose(error("scale_drift", at([50.0] * 3, t_s=t), amplitude=10.0), [0, 5e-4, 1e-3])
    np.testing.assert_allclose(
        error("bias_step", at([1.0] * 3, t_s=t), amplitude=3.0, at_s=3600.0), [0, 3e-3, 3e-3]
    )
    np.testing.assert_allclose(
        error("scale_step", at([-50.0] * 3, t_s=t), amplitude=100.0, at_s=3601.0), [0, 0, -5e-3]
    )
    rates = [-100.0, 0.0, 0.005, 100.0]
    np.testing.assert_allclose(error("scale_asymmetry", at(rates), amplitude=200.0), [0, 0, 1e-6, 0.02])
    # However soft, what turning one way adds to the other is the whole of it, and at rest nothing is added.
    left, rest, right = error("scale_asymmetry", at([50.0, 0.0, -50.0]), amplitude=200.0, softness_dps=8.0)
    np.testing.assert_allclose([left - right, rest], [0.01, 0.0], atol=1e-15)
    np.testing.assert_allclose(right, -2e-4 * 8.0 * np.log(2.0), rtol=3e-3)
    np.testing.assert_allclose(error("dead_zone", at(rates), amplitude=2.8), [0, -2.8e-3, -2.8e-3, 0])
    np.testing.assert_allclose(
        error("dead_zone", at([-0.005, 0.0, 0.02]), amplitude=10.0, form=1.0), [5e-3, 0, 0], atol=1e-12
    )
    # Of an input a quarter above the zone, lock-in leaves 0.75 of its half width.
    np.testing.assert_allclose(
        error("dead_zone", at([0.005, 0.0125, -0.0125]), amplitude=10.0, form=2.0), [-5e-3, -5e-3, 5e-3]
    )
    # To a robot an output below half the width is rest; and where in the zone the input is, is not known.
    taken = {
        form: error(
            "dead_zone", at([-0.004, 0.012, 0.04]), amplitude=10.0, form=form, rest=0.5, place_dps=1e-3
        )
        for form in (1.0, 2.0, 3.0)
    }
    np.testing.assert_allclose(taken[1.0], [1e-3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(taken[2.0], [1e-3, np.sqrt(0.44) * 1e-2 - 1.2e-2, np.sqrt(15.0) * 1e-2 - 4e-2])
    np.testing.assert_allclose(taken[3.0], [1e-3, -7e-3, -1e-2])
    np.testing.assert_allclose(error("truncation", at(rates), amplitude=1.5), [1.5e-3, 0, -1.5e-3, -1.5e-3])
    np.testing.assert_allclose(error("truncation", at(rates), amplitude=-1.5), [-1.5e-3, 0, 1.5e-3, 1.5e-3])
    np.testing.assert_allclose(
        error("saturation", at(rates), amplitude=0.01, knee_dps=80.0), [0.2, 0, 0, -0.2]
    )
    np.testing.assert_allclose(
        error("sagnac_sine", at([100.0]), amplitude=1.0, phase_rad_per_dps=0.005), np.sin(0.5) / 0.005 - 100
    )
    np.testing.assert_allclose(error("rate_order", at([-50.0]), amplitude=32.0, order=5.0), -1e-3)
    np.testing.assert_allclose(
        error("temperature_order", at([0.0], temp_c=np.array([-10.0])), amplitude=7.0), -7e-3
    )
    np.testing.assert_allclose(
        error("supply_voltage", at([0.0], supply_v=np.array([11.5])), amplitude=2.0), -1e-3
    )
    np.testing.assert_allclose(error("time_base", at([100.0]), amplitude=1000.0), 0.1)


def test_angle_laws_by_hand() -> None:
    theta = np.array([0.0, 90.0, 180.0])
    for effect_id in ("earth_rate_tilt", "magnetic", "g_sensitivity"):
        np.testing.assert_allclose(
            error(effect_id, at([5.0] * 3, angle_deg=theta), amplitude=1.0, phase_rad=np.pi / 2),
            [0, 1e-3, 0],
            atol=1e-15,
        )
    arcsec_rad = np.pi / 180 / 3600
    np.testing.assert_allclose(
        error("table_eccentricity", at([100.0] * 3, angle_deg=theta), amplitude=1.0, harmonic=2.0),
        200 * arcsec_rad * np.array([-1, 1, -1]),
    )


def test_table_eccentricity_is_a_true_gyro_minus_the_derivative_of_the_reading() -> None:
    t = np.linspace(0.0, 10.0, 20001)
    theta = 37.0 * t
    epsilon_deg, k, phi = 20.0 / 3600, 2, 0.7
    reading_error = epsilon_deg * np.sin(k * np.deg2rad(theta) + phi)
    law = error(
        "table_eccentricity", at(np.full(t.size, 37.0), angle_deg=theta),
        amplitude=20.0, harmonic=2.0, phase_rad=phi,
    )  # fmt: skip
    np.testing.assert_allclose(law[1:-1], -np.gradient(reading_error, t)[1:-1], atol=1e-8)


def test_step_response_rings_and_decays() -> None:
    since = np.array([-1.0, 0.0, 2.0])
    c = at([0.0] * 3, since_step_s=since, step_dps=np.full(3, 20.0))
    np.testing.assert_allclose(
        error("step_response", c, amplitude=5.0, tau_s=2.0, frequency_hz=0.25),
        [0, 10e-3, -10e-3 / np.e],
        atol=1e-15,
    )


def test_a_long_row_has_the_mean_of_a_step_response() -> None:
    """A sample of ten seconds at the end of a sweep: at its stamp the law would put all of the response into it."""
    p = {"amplitude": 5.0, "tau_s": 2.0, "frequency_hz": 0.3, "phase_rad": 0.4}
    instants = np.arange(0.0005, 20.0, 0.001)
    n = instants.size
    fine = error("step_response", at([0.0] * n, since_step_s=instants, step_dps=np.full(n, 20.0)), None, **p)
    expected = [fine[:10000].mean(), fine[10000:].mean()]
    for since in ([5.0, 15.0], [0.0, 15.0]):
        rows = at([0.0, 0.0], since_step_s=np.array(since), step_dps=np.full(2, 20.0), row_s=np.full(2, 10.0))
        np.testing.assert_allclose(error("step_response", rows, None, **p), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("effect", "shape"), [("thermal_hysteresis", {"width_c": 2.0}), ("warm_up", {"tau_s": 100.0})]
)
def test_what_acts_on_the_bias_may_act_on_the_scale_factor(effect: str, shape: dict[str, float]) -> None:
    c = at(
        [-100.0, 0.0, 50.0], temp_c=np.array([20.0, 30.0, 25.0]), since_power_on_s=np.array([0.0, 50.0, 99.0])
    )
    of_bias = error(effect, c, None, amplitude=5.0, **shape)
    assert np.abs(of_bias).max() > 1e-3
    of_scale = error(effect, c, None, amplitude=5.0, of_scale=1.0, **shape)
    np.testing.assert_allclose(of_scale, of_bias * np.array([-1.0, 0.0, 0.5]), atol=1e-15)


def test_fit_direction_makes_the_output_a_cubic_of_the_input() -> None:
    rate = np.linspace(-100, 100, 21)
    output = SURFACE.output_dps(rate, 35.0) + error(
        "fit_direction", at(rate, temp_c=np.full(21, 35.0)), SURFACE, amplitude=1.0
    )
    np.testing.assert_allclose(output, rate + SURFACE.error_dps(rate, 35.0), atol=1e-10)


def test_output_steps() -> None:
    output = np.array([-0.0125, 0.004, 0.0061])
    c = at([0.0, 0.0, 0.0], gyro_dps=output)
    np.testing.assert_allclose(
        output + error("quantisation", c, amplitude=4.0), [-0.012, 0.004, 0.008], atol=1e-15
    )
    np.testing.assert_allclose(
        output + error("truncation", c, amplitude=2.0), [-0.012, 0.004, 0.004], atol=1e-15
    )
    np.testing.assert_allclose(
        output + error("truncation", c, amplitude=-2.0), [-0.016, 0.004, 0.008], atol=1e-15
    )


def test_truncation_of_a_noisy_output_has_the_stated_mean() -> None:
    rng = np.random.default_rng(5)
    output = 30.0 + rng.uniform(-1.0, 1.0, 20_000)
    c = at(np.full(output.size, 30.0), gyro_dps=output)
    cut = error("truncation", c, amplitude=1.5)
    mean = error("truncation", at([30.0]), amplitude=1.5)[0]
    # Uniform in (-q, 0): standard deviation q / sqrt(12); 4.9 sigma is a false-alarm rate of 1e-6.
    assert abs(cut.mean() - mean) < 4.9 * 3e-3 / np.sqrt(12 * output.size)


def test_reference_error_belongs_to_the_commanded_rate() -> None:
    c = at([60.0, -60.0, 60.0004, 30.0], command_dps=np.array([60.0, -60.0, 60.0, 30.0]))
    e = error("reference_rate_error", c, amplitude=50.0) / c.rate_dps
    assert e[0] == pytest.approx(e[1])
    assert e[0] == pytest.approx(e[2])
    assert abs(e[0] - e[3]) > 1e-7


def test_bursts_fill_their_share_of_time() -> None:
    t = np.arange(0.0, 20_000.0, 0.1)
    e = error("bursts", at(np.zeros(t.size), t_s=t), amplitude=50.0, share=0.2, duration_s=0.5)
    windows = t.size / 5
    inside = e != 0
    assert abs(inside.mean() - 0.2) < 4.9 * np.sqrt(0.2 * 0.8 / windows)
    assert abs(e[inside].std() - 0.05) < 4.9 * 0.05 / np.sqrt(2 * inside.sum())


def test_resonance_is_local_and_scatters() -> None:
    rates = np.concatenate([np.full(2000, 60.0), np.full(2000, -60.0), np.full(2000, 20.0)])
    c = at(rates)
    e = error("mechanical_resonance", c, amplitude=5.0, center_dps=60.0, width_dps=2.0, scatter=0.5)
    assert abs(e[:4000].mean() - 5e-3) < 4.9 * 2.5e-3 / np.sqrt(4000)
    assert np.abs(e[4000:]).max() < 1e-4


def test_a_peak_of_either_form_is_half_as_high_half_a_width_off() -> None:
    c = at([60.0, -58.0, 62.0, 52.0])
    lorentz, gauss = (
        error(
            "mechanical_resonance", c, amplitude=8.0, center_dps=60.0, width_dps=2.0, scatter=0.0, form=form
        )
        for form in (0.0, 1.0)
    )
    np.testing.assert_allclose(lorentz, [8e-3, 4e-3, 4e-3, 8e-3 / 17.0])
    np.testing.assert_allclose(gauss, [8e-3, 4e-3, 4e-3, 8e-3 * 2.0**-16])


def test_what_cuts_the_output_is_smeared_by_the_noise_of_its_samples() -> None:
    c = replace(at([-5.0, 0.0, 0.0, 0.0, 5.0]), sample_std_dps=0.004)
    bias = np.zeros((4, 3))
    bias[0, 0] = 0.002
    surface = Surface(bias, 0.0, 100.0, 20.0, 30.0)
    loss_mdps = 1e3 * find_effect("truncation").unit_dps(c, {"of_output": 1.0}, surface)
    # At half a standard deviation of the samples a share of 0.383 more of them is above zero than below.
    np.testing.assert_allclose(loss_mdps, [1.0, -0.383, -0.383, -0.383, -1.0], atol=1e-3)


def test_a_row_in_which_the_bias_jumps_has_its_share_of_the_jump() -> None:
    c = replace(at([0.0] * 4), row_s=np.full(4, 2.0))  # rows of 2 s around 0, 1, 2, 3 s
    jump = find_effect("bias_step").unit_dps(c, {"at_s": 1.5}, None)
    np.testing.assert_allclose(1e3 * jump, [0.0, 0.25, 0.75, 1.0])


@pytest.mark.parametrize("name", ["earth_rate_tilt", "table_eccentricity"])
def test_a_row_in_which_the_table_turns_has_the_mean_over_its_turn(name: str) -> None:
    effect, shape = find_effect(name), {"phase_rad": 0.7}
    rates_dps, row_s = np.array([-40.0, 5.0, 100.0]), np.array([0.5, 4.0, 0.2])
    t = np.linspace(-0.5, 0.5, 20_001)[:, None] * row_s
    fine = replace(at(np.tile(rates_dps, len(t))), angle_deg=(30.0 + t * rates_dps).ravel())
    rows = replace(at(rates_dps), angle_deg=np.full(3, 30.0), row_s=row_s)
    expected = effect.unit_dps(fine, shape, None).reshape(t.shape).mean(axis=0)
    np.testing.assert_allclose(effect.unit_dps(rows, shape, None), expected, rtol=1e-6)


def test_a_soft_knee_becomes_the_hard_one_away_from_it() -> None:
    rates = [-100.0, -80.0, 0.0, 80.0, 100.0]
    hard = error("saturation", at(rates), amplitude=0.01, knee_dps=80.0)
    soft = error("saturation", at(rates), amplitude=0.01, knee_dps=80.0, softness_dps=0.5)
    np.testing.assert_allclose(soft[[0, 2, 4]], hard[[0, 2, 4]], atol=1e-12)
    # At the knee itself s log 2 are missing.
    np.testing.assert_allclose(soft[[1, 3]], [0.01 * 0.5 * np.log(2), -0.01 * 0.5 * np.log(2)])


def test_truncation_goes_by_the_output_where_its_bias_is_larger_than_the_rate() -> None:
    bias = np.zeros((4, 3))
    bias[0, 0] = 0.1
    surface = Surface(bias, 0.0, 100.0, 20.0, 30.0)
    c = at([-5.0, -0.05, 0.0, 0.05, 5.0])
    loss_mdps = 1e3 * find_effect("truncation").unit_dps(c, {"of_output": 1.0}, surface)
    np.testing.assert_allclose(loss_mdps, [1.0, -1.0, -1.0, -1.0, -1.0])


def test_a_drift_counts_from_where_it_is_told_to() -> None:
    t = 1.76e9 + np.array([0.0, 3600.0, 7200.0])
    found = error("bias_drift", at([0.0] * 3, t_s=t), amplitude=2.0, power=0.5, from_s=1.76e9)
    np.testing.assert_allclose(found, [0, 2e-3, 2e-3 * np.sqrt(2.0)])
