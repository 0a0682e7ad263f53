"""The virtual world obeys its own laws: acceleration, lag, ripple, sag, and effects where they physically act."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from gyrocal.bench.devices import GyroSamples
from gyrocal.bench.virtual.devices import VirtualTable, virtual_bench
from gyrocal.bench.virtual.world import World
from gyrocal.errors import DeviceError
from gyrocal.physics.catalogue import CATALOGUE
from tests.bench.tiny import tiny_profile

QUIET = {
    "virtual__gyro": {
        "angle_random_walk_deg_per_rt_h": 0.0,
        "bias_instability_deg_per_h": 0.0,
        "lsb_deg": 0.0,
        "temp_lsb_c": 0.0,
    },
    "virtual__table": {"wobble_deg": 0.0, "rate_error_ppm": 0.0},
    "virtual__chamber": {"ripple_c": 0.0, "noise_c": 0.0, "air_s": 60.0, "case_s": 400.0},
    "virtual__supply": {"noise_v": 0.0},
}


def world(**changes: Any) -> World:
    """A world of the tiny profile."""
    return virtual_bench(tiny_profile(**changes))[2]


def run_at(w: World, rate_dps: float, length_s: float) -> GyroSamples:
    """Samples at a rate, once the table is there."""
    w.command_rate(rate_dps)
    w.advance_to(w.now_s + 60.0)
    w.take_gyro()
    w.advance_to(w.now_s + length_s)
    return w.take_gyro()


def test_table_keeps_its_acceleration_and_its_angle_is_the_integral() -> None:
    w = world(**QUIET)
    w.command_rate(100.0)
    rates, angles = [], []
    for k in range(1, 41):
        w.advance_to(0.1 * k)
        rate, angle = w.read_table()
        rates.append(rate)
        angles.append(angle)
    assert np.max(np.diff(rates)) <= 50.0 * 0.1 + 1e-3
    assert rates[-1] == pytest.approx(100.0)
    # 2 s at 50 deg/s^2, then 2 s at 100 deg/s
    assert angles[-1] == pytest.approx(100.0 + 200.0, abs=1e-3)
    assert np.sum(rates) * 0.1 == pytest.approx(angles[-1], abs=1e-3)


def test_encoder_resolves_its_step() -> None:
    w = world()
    w.command_rate(7.3)
    w.advance_to(33.0)
    _, angle = w.read_table()
    assert angle / 1e-5 == pytest.approx(round(angle / 1e-5), abs=1e-4)


def test_standing_table_does_not_wobble_and_a_turning_one_does() -> None:
    w = world()
    angles = []
    for rate in (0.0, 10.0):
        w.command_rate(rate)
        w.advance_to(w.now_s + 30.0)
        path = []
        for _ in range(200):
            w.advance_to(w.now_s + 0.1)
            path.append(w.read_table()[1])
        angles.append(np.std(np.diff(path) - rate * 0.1))
    assert angles[0] == 0.0
    assert 2e-5 < angles[1] < 2e-3


def test_table_and_chamber_refuse_what_they_cannot_do() -> None:
    w = world()
    with pytest.raises(DeviceError, match=r"refuses 500 deg/s: it can do 400 deg/s at most"):
        w.command_rate(500.0)
    with pytest.raises(DeviceError, match="refuses nan"):
        w.command_rate(float("nan"))
    with pytest.raises(DeviceError, match=r"refuses 200 °C: its set points go from -70 to 180 °C"):
        w.command_temperature(200.0, None)


def test_air_follows_the_ramp_and_the_case_follows_the_air() -> None:
    w = world(**QUIET)
    w.command_temperature(41.0, 2.0)
    w.advance_to(600.0)
    # the ramp is over at 600 s; air lags 60 s and the case another 400 s behind a ramp of 2 degC/min
    rate_c_per_s = 2.0 / 60.0
    air_behind = rate_c_per_s * 60.0 * (1 - np.exp(-10.0))
    air_c, set_c = w.read_chamber()
    assert air_c == pytest.approx(41.0 - air_behind, abs=0.01)
    assert set_c == 41.0
    case = w.take_gyro().gyro_temp_c
    t = 600.0
    both = rate_c_per_s * (
        t - 460.0 + (400.0**2 * np.exp(-t / 400.0) - 60.0**2 * np.exp(-t / 60.0)) / (400.0 - 60.0)
    )
    assert np.mean(case[-20:]) == pytest.approx(21.0 + both, abs=0.1)
    w.advance_to(6000.0)
    assert w.read_chamber()[0] == pytest.approx(41.0, abs=1e-3)


def test_compressor_ripples_the_air() -> None:
    w = world(virtual__chamber={"ripple_c": 0.3, "ripple_period_s": 100.0, "noise_c": 0.0})
    air = []
    for k in range(1, 1001):
        w.advance_to(0.5 * k)
        air.append(w.read_chamber()[0])
    assert np.ptp(air) == pytest.approx(0.6, rel=0.02)


def test_supply_sags_with_the_table_and_with_the_compressor() -> None:
    w = world(virtual__supply={"noise_v": 0.0, "sag_v": 0.1, "compressor_v": 0.03})
    w.advance_to(10.0)
    assert w.read_supply() == pytest.approx(12.0 - 0.03)
    w.command_rate(-50.0)
    w.advance_to(130.0)  # in the second half of the ripple's period of 240 s
    assert w.read_supply() == pytest.approx(12.0 - 0.05)


def test_gyro_output_solves_its_surface_at_the_true_rate() -> None:
    w = world(**QUIET)
    samples = run_at(w, 60.0, 5.0)
    error = w.spec.gyro.surface.error_dps(samples.gyro_dps, 21.0)
    assert samples.gyro_dps - error == pytest.approx(60.0, abs=1e-9)


def test_any_split_of_time_gives_the_same_world() -> None:
    results = []
    for steps in (1, 7, 60):
        w = world()
        w.command_rate(25.0)
        w.command_temperature(30.0, 3.0)
        for k in range(1, steps + 1):
            w.advance_to(60.0 * k / steps)
        results.append((w.take_gyro(), w.read_table(), w.now_s))
    for other in results[1:]:
        assert other[1:] == results[0][1:]
        for name in ("t_s", "gyro_dps", "gyro_temp_c"):
            assert np.array_equal(getattr(other[0], name), getattr(results[0][0], name))


def mean_shift(effects: dict[str, Any], rate_dps: float, length_s: float = 5.0, **changes: Any) -> float:
    """What effects add to the mean of gyro minus encoder, noise free."""
    shifts = []
    for spec in (effects, {}):
        w = world(**{**QUIET, **changes}, virtual__effects=spec)
        w.command_rate(rate_dps)
        w.advance_to(60.0)
        w.take_gyro()
        before = w.read_table()[1]
        w.advance_to(60.0 + length_s)
        encoder = (w.read_table()[1] - before) / length_s
        shifts.append(float(np.mean(w.take_gyro().gyro_dps)) - encoder)
    return shifts[0] - shifts[1]


def test_bias_effects_add_to_the_output() -> None:
    assert mean_shift({"bias_step": {"amplitude": 5.0, "at_s": 0.0}}, 0.0) == pytest.approx(0.005)
    assert mean_shift({"bias_step": {"amplitude": 5.0, "at_s": 1e6}}, 0.0) == 0.0
    assert mean_shift({"scale_step": {"amplitude": 300.0, "at_s": 0.0}}, 50.0) == pytest.approx(
        0.015, rel=1e-3
    )


def test_effects_of_the_reference_act_on_the_true_rate() -> None:
    effects = {"table_eccentricity": {"amplitude": 30.0, "phase_rad": 0.3}}
    w, plain = world(**QUIET, virtual__effects=effects), world(**QUIET)
    with_effect, without = run_at(w, 36.0, 20.0), run_at(plain, 36.0, 20.0)
    # the encoder sees the same turn in both worlds
    assert w.read_table() == plain.read_table()
    # what the gyro sees is the eccentricity, through the gyro's own slope
    shift = with_effect.gyro_dps - without.gyro_dps
    epsilon = np.deg2rad(30.0 / 3600.0)
    assert np.ptp(shift) == pytest.approx(2 * epsilon * 36.0, rel=0.05)
    assert np.mean(shift) == pytest.approx(0.0, abs=1e-5)


def test_quantisation_replaces_the_units_own_bits() -> None:
    w = world(virtual__effects={"quantisation": {"amplitude": 50.0}})
    gyro = run_at(w, 10.0, 30.0).gyro_dps
    assert gyro / 0.05 == pytest.approx(np.round(gyro / 0.05), abs=1e-6)


@pytest.mark.parametrize("effect_id", sorted(CATALOGUE))
def test_every_effect_can_be_switched_on(effect_id: str) -> None:
    given = {"share": 0.2} if effect_id == "bursts" else {}  # the usual share is one burst in two minutes
    w, plain = world(virtual__effects={effect_id: given}), world()
    results = []
    for each in (w, plain):
        each.command_temperature(30.0, 5.0)
        each.advance_to(40.0)
        each.command_rate(95.0)
        each.advance_to(120.0)
        each.command_rate(-12.5)
        each.advance_to(200.0)
        results.append(each.take_gyro())
    assert np.all(np.isfinite(results[0].gyro_dps))
    visible_here = effect_id not in ("bias_step", "scale_step")  # they come after an hour
    assert np.array_equal(results[0].gyro_dps, results[1].gyro_dps) != visible_here


def test_memory_of_an_effect_lives_on_between_drains() -> None:
    effects = {"shupe_gradient": {"amplitude": 10.0}}
    outputs = []
    for drains in (1, 40):
        w = world(virtual__effects=effects)
        w.command_temperature(30.0, 5.0)
        parts = []
        for k in range(1, drains + 1):
            w.advance_to(200.0 * k / drains)
            parts.append(w.take_gyro().gyro_dps)
        outputs.append(np.concatenate(parts))
    # quantisation may round either way where block sums differ in their last bit
    assert outputs[0] == pytest.approx(outputs[1], abs=0.00306)
    assert np.mean(np.abs(outputs[0] - outputs[1])) < 1e-5


def test_reference_rate_error_differs_between_commands() -> None:
    w = world(**{**QUIET, "virtual__table": {"wobble_deg": 0.0, "rate_error_ppm": 50.0}})
    surface = w.spec.gyro.surface
    errors = []
    for k in range(60):
        samples = run_at(w, 50.0 if k % 2 else 40.0, 1.0)
        rate = samples.gyro_dps - surface.error_dps(samples.gyro_dps, 21.0)
        errors.append(np.mean(rate) / (50.0 if k % 2 else 40.0) - 1.0)
    low, high = (stats.chi2.ppf(q, 60) for q in (0.5e-4, 1 - 0.5e-4))
    assert low < np.sum(np.square(errors)) / 50e-6**2 < high


def test_devices_stop_and_report() -> None:
    bench, clock, w = virtual_bench(tiny_profile())
    assert isinstance(bench.table, VirtualTable)
    assert bench.table.set_rate(30.0) == 30.0
    clock.sleep(5.0)
    assert bench.table.read().rate_dps == pytest.approx(30.0, abs=0.02)
    bench.table.send_stop()
    clock.sleep(2.0)
    assert bench.table.read().rate_dps == 0.0
    assert bench.gyro.drain().t_s[-1] == pytest.approx(clock.now_s())
    assert bench.gyro.health().frames_good == 70
    assert w.now_s == pytest.approx(clock.now_s())
