"""Whether an output follows the rate: the mistakes that a surface would swallow, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.records.scale import gross_row, odd_output, output_scale

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
