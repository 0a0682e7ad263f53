"""Whether an output follows the rate: the mistakes that a surface would swallow, and what is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gyrocal.records.scale import (
    gross_row,
    odd_order,
    odd_output,
    odd_part,
    odd_rates,
    output_scale,
    unclipped,
)

RATE = np.tile(np.linspace(-100.0, 100.0, 11), 4)


def output(scale: float = 1.0) -> np.ndarray:
    return scale * RATE + 3.0 + 0.01 * np.random.default_rng(1).standard_normal(RATE.size)


@pytest.mark.parametrize("scale", [0.7, 0.97, 1.0, 1.05, 1.4])
def test_a_gyros_scale_error_is_no_other_unit(scale: float) -> None:
    assert odd_output(RATE, output(scale)) is None
    assert output_scale(RATE, output(scale)) == pytest.approx(scale, abs=1e-3)


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (np.pi / 180, "it is in rad/s"),
        (180 / np.pi, "the rate is in rad/s"),
        (-1.02, "inverted"),
        (0.5, "half of the rate"),
        (2.0, "twice the rate"),
        (3600.0, "deg/h"),
        (1 / 360, "(it is in rev/s)"),
        (1 / 6, "(it is in rpm)"),
        (6.0, "(the rate is in rpm)"),
        (0.965 * np.pi / 180, "(it is in rad/s, or the rate is in deg/min)"),
        (60.0, "(the rate is in rad/s, or it is in deg/min, or in counts of another scale)"),
        (27312.6, "another unit or sign"),
        (1e-4, "does not follow the rate"),
    ],
)
def test_the_usual_mistakes_are_told_by_their_name(scale: float, said: str) -> None:
    odd = odd_output(RATE, output(scale))
    assert odd is not None
    assert said in odd.what


def test_a_gyro_that_says_one_thing_is_stuck() -> None:
    odd = odd_output(np.zeros(50), np.full(50, 0.1))
    assert odd is not None
    assert "stuck" in odd.what


def test_one_wild_value_is_found_and_does_not_move_the_scale() -> None:
    gyro = output()
    gyro[7] = 1e30
    assert gross_row(RATE, gyro) == 7
    assert output_scale(RATE, gyro) == pytest.approx(1.0, abs=1e-3)
    gyro[7] = -100.0
    assert gross_row(RATE, gyro) is None
    assert np.isnan(output_scale(np.zeros(9), gyro[:9]))


#: Five temperatures in order, eleven rates at each.
RATES = np.tile(np.linspace(-100.0, 100.0, 11), 5)
TEMPS = np.repeat([-20.0, 0.0, 20.0, 40.0, 60.0], 11)
NUMBERS = np.arange(1, 56)


def told(part: np.ndarray, times: float) -> np.ndarray:
    gyro = 1.01 * RATES + 0.5 + 0.01 * np.random.default_rng(2).standard_normal(RATES.size)
    return np.where(part, times * gyro, gyro)


@pytest.mark.parametrize(
    ("times", "meaning"),
    [
        (np.pi / 180, "0.0176 times the rate (it is in rad/s)"),
        (3600.0, "times the rate (it is in deg/h)"),
        (1000.0, "times the rate (it is in mdeg/s)"),
        (-1.0, "-1.01 times the rate (the sign of the output, or that of the rate, is inverted)"),
    ],
)
def test_an_output_that_changes_its_unit_is_told_with_where_it_does(times: float, meaning: str) -> None:
    for part, where in (
        (NUMBERS > 33, "in data sets 34 to 55 (lines 35 to 56, 40.0 to 60.0 °C)"),
        (NUMBERS > 11, "in data sets 12 to 55 (lines 13 to 56, 0.0 to 60.0 °C)"),
        (TEMPS == 0.0, "in data sets 12 to 22 (lines 13 to 23, 0.0 °C)"),
    ):
        odd = odd_part(RATES, told(part, times), TEMPS, NUMBERS, lines=True)
        assert odd is not None
        assert where in odd.what
        assert meaning in odd.what
        assert not odd.a_scale


def test_an_output_that_bends_and_is_in_one_unit_throughout_changes_none() -> None:
    """Of an open loop in rad/s small rates were in rad/s and large ones in deg/min, "elsewhere it is not"."""
    bent = np.radians(RATE - 8.0 * (RATE / 100.0) ** 3)
    assert odd_part(RATE, bent, np.full(RATE.size, 25.0), np.arange(1, RATE.size + 1), lines=True) is None
    odd = odd_output(RATE, bent)
    assert odd is not None
    assert "it is in rad/s" in odd.what


def test_a_temperature_in_another_unit_is_told_in_whatever_order_the_rows_are() -> None:
    order = np.argsort(RATES, kind="stable")
    gyro = told(TEMPS == 0.0, np.pi / 180)
    odd = odd_part(RATES[order], gyro[order], TEMPS[order], NUMBERS, lines=False)
    assert odd is not None
    assert "in 8 data sets at 0.0 °C (the first is 2)" in odd.what


@pytest.mark.parametrize("first", [1, 9, 30, 45, 51])
@pytest.mark.parametrize(
    ("times", "meaning"),
    [(np.pi / 180, "rad/s"), (3600.0, "deg/h"), (1000.0, "mdeg/s"), (1 / 6, "rpm"), (1 / 360, "rev/s")],
)
def test_a_few_rows_in_another_unit_are_told_apart_from_disturbed_ones(
    times: float, meaning: str, first: int
) -> None:
    for count in (3, 5):
        part = (first <= NUMBERS) & (first + count > NUMBERS)
        odd = odd_part(RATES, told(part, times), TEMPS, NUMBERS, lines=True)
        assert odd is not None
        assert f"it is in {meaning}" in odd.what
    rates = np.where(part, RATES * times, RATES)
    odd = odd_part(rates, told(NUMBERS < 0, 1.0), TEMPS, NUMBERS, lines=True)
    assert odd is not None
    assert f"the rate is in {meaning}" in odd.what


def test_a_few_rows_that_are_off_are_in_no_other_unit() -> None:
    """In 300 made-up tables of sets that are mixed up, disturbed, lost or stuck none is refused."""
    rng = np.random.default_rng(6)
    for _ in range(60):
        rows = rng.integers(0, NUMBERS.size - 5) + np.arange(3)
        sound = told(NUMBERS < 0, 1.0)
        for wrong in (
            sound[rng.choice(NUMBERS.size, 3)],
            rng.uniform(-100.0, 100.0, 3),
            1e-3 * rng.standard_normal(3),
            np.full(3, sound[rows[0]]),
            sound[rows] * np.exp(rng.uniform(-4.0, 4.0)),
        ):
            gyro = sound.copy()
            gyro[rows] = wrong
            assert odd_part(RATES, gyro, TEMPS, NUMBERS, lines=True) is None


@pytest.mark.parametrize("most", [22.0, 39.0, 60.0, 90.0])
def test_a_clipped_gyro_is_in_no_other_unit(most: float) -> None:
    gyro = np.clip(told(NUMBERS < 0, 1.0), -most, most)
    assert odd_output(RATES, gyro) is None
    odd = odd_output(RATES, gyro * np.pi / 180)
    assert odd is not None
    assert "rad/s" in odd.what
    assert np.array_equal(unclipped(RATES, gyro), np.abs(gyro) < most) or most == 90.0
    assert unclipped(RATES, told(NUMBERS < 0, 1.0)).all()


def _clipped() -> np.ndarray:
    return np.asarray(np.clip(told(NUMBERS < 0, 1.0), -45.0, 45.0))


def _open_loop() -> np.ndarray:
    phase = RATES / 100.0 * 1.6
    return np.asarray(100.0 / 1.6 * np.sin(phase) * 1.2)


def _dead_band() -> np.ndarray:
    gyro = told(NUMBERS < 0, 1.0)
    return np.where(np.abs(RATES) < 45.0, 0.02 * RATES, gyro)


def _outliers() -> np.ndarray:
    gyro = told(NUMBERS < 0, 1.0)
    gyro[[5, 17, 30, 31, 44]] *= -1.0
    gyro[12] = 1e5
    return gyro


def _biased() -> np.ndarray:
    return told(NUMBERS < 0, 1.0) - np.linspace(-150.0, 250.0, RATES.size)


@pytest.mark.parametrize("gyro", [_clipped, _open_loop, _dead_band, _outliers, _biased])
def test_what_a_gyro_does_is_no_change_of_unit(gyro: Callable[[], np.ndarray]) -> None:
    assert odd_part(RATES, gyro(), TEMPS, NUMBERS, lines=True) is None
    assert odd_part(np.full(55, 15.0), gyro(), TEMPS, NUMBERS, lines=True) is None


PLANS = ([5, 20, 50, 100], [1, 2, 5, 10, 20, 50], [0.5, 1, 1.5, 2], [12.5, 25, 50, 75], [10, 60, 200, 400])


@pytest.mark.parametrize("plan", PLANS)
def test_rates_and_outputs_both_in_radians_are_told_by_round_rates(plan: list[float]) -> None:
    rng = np.random.default_rng(8)
    rate = np.tile([*(-r for r in plan), 0.0, *plan], 3).astype(float)
    wobble = rate * (1.0 + 2e-5 * rng.standard_normal(rate.size))
    for told in (np.round(np.deg2rad(rate), 6), np.deg2rad(wobble)):
        odd = odd_rates(np.asarray(told, dtype=np.float64))
        assert odd is not None
        assert "rad/s" in odd.what
    # As they were planned, and as a table reports them.
    assert odd_rates(rate) is None
    assert odd_rates(wobble) is None


def test_slow_rates_in_degrees_are_no_radians() -> None:
    for step in (0.25, 0.1, 1.0 / 3.0, 0.125, 0.7, 2.5):
        for most in (3, 4, 5, 8):
            rate = step * np.arange(-most, most + 1)
            assert odd_rates(np.asarray(rate, dtype=np.float64)) is None
            assert odd_rates(np.asarray(np.round(rate, 2), dtype=np.float64)) is None
    rng = np.random.default_rng(9)
    assert sum(odd_rates(rng.uniform(-10.0, 10.0, 7)) is not None for _ in range(2000)) == 0


def test_rate_and_output_in_each_others_place_are_told() -> None:
    odd = odd_order(output(), RATE)
    assert odd is not None
    assert "gyro_dps has 11 values in 44 rows" in odd.what
    assert odd_order(RATE, output()) is None
    # A coarse gyro repeats itself, too, but not in both directions alike.
    assert odd_order(output(), np.round(output(), 0)) is None
    # A simulation without errors has the rates for an output, and rates of its own.
    assert odd_order(RATE, RATE) is None


@pytest.mark.parametrize("scatter_dps", [3e-5, 2e-3])
def test_rates_that_a_table_read_back_are_seen_in_the_outputs_place(scatter_dps: float) -> None:
    rng = np.random.default_rng(3)
    read = np.round(RATE + scatter_dps * rng.standard_normal(RATE.size), 6)
    said = read * (1.0 + 2e-3 * rng.standard_normal(RATE.size)) + 0.01
    odd = odd_order(said, read)
    assert odd is not None
    assert "gyro_dps has 11 values (within " in odd.what
    assert odd_order(read, said) is None
    # A gyro without a bias that scatters as the table does, which then cannot be told from it.
    assert odd_order(read, read + scatter_dps * rng.standard_normal(RATE.size)) is None
