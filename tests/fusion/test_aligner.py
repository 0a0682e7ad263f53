"""Delay and encoder window: what comes out is on one clock, whatever the blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.fusion import Aligner, EncoderFigures, GyroFigures, Navigator, RobotParameters, Rows

Floats = NDArray[np.float64]
DT = 0.02
T: Floats = np.arange(0.0, 40.0, DT)
ROBOT = RobotParameters(0.5)


def heading(t: Floats) -> Floats:
    """Degrees, smooth, still at both ends."""
    inside = np.clip((t - 5.0) / 30.0, 0.0, 1.0)
    return np.asarray(200.0 * (inside - np.sin(4.0 * np.pi * inside) / (4.0 * np.pi)))


def rate(t: Floats) -> Floats:
    """Mean rate over the row that ends at `t`, deg/s."""
    return (heading(t) - heading(t - DT)) / DT


def aligned(robot: RobotParameters, *columns: Floats, chunk: int = 10**6) -> Rows:
    aligner = Aligner(robot)
    parts = [aligner.push(*(c[k : k + chunk] for c in columns)) for k in range(0, columns[0].size, chunk)]
    parts.append(aligner.flush())
    return Rows(*(np.concatenate(c) for c in zip(*(vars(p).values() for p in parts), strict=True)))


def columns(gyro_late_s: float = 0.0, encoders_late_s: float = 0.0) -> tuple[Floats, ...]:
    half = 0.25 * np.radians(rate(T - encoders_late_s)) * DT
    return T, 0.01 - half, 0.01 + half, rate(T - gyro_late_s), np.full(T.size, 20.0)


def test_nothing_to_do_is_nothing_done() -> None:
    rows = aligned(ROBOT, *columns())
    for got, given in zip(vars(rows).values(), (*columns(), np.zeros(T.size)), strict=True):
        np.testing.assert_array_equal(got, given)


@pytest.mark.parametrize("delay_s", [0.12, 0.137, -0.12])
def test_what_is_late_is_shifted_forward(delay_s: float) -> None:
    robot = replace(ROBOT, gyro=GyroFigures(delay_s=delay_s))
    rows = aligned(robot, *columns(max(delay_s, 0.0), max(-delay_s, 0.0)))
    _, left, right, gyro, _ = columns()
    np.testing.assert_array_equal(rows.t_s, T)
    np.testing.assert_allclose(np.cumsum(rows.gyro_dps) * DT, np.cumsum(gyro) * DT, atol=0.005)
    turned, expected = (
        np.degrees(np.cumsum(r - le) / 0.5) for r, le in ((rows.right_m, rows.left_m), (right, left))
    )
    np.testing.assert_allclose(turned, expected, atol=0.005)


def test_the_gyro_smoothed_alike_turns_as_the_encoders() -> None:
    robot = replace(ROBOT, encoders=EncoderFigures(window_s=1.0))
    t, *_, gyro, temp = columns()
    fine = np.arange(-0.5, 0.5, 0.001) + 0.0005
    smoothed = np.mean([heading(t + u) for u in fine], axis=0)
    rows = aligned(robot, t, np.zeros(t.size), np.zeros(t.size), gyro, temp)
    turned = np.cumsum((rows.gyro_dps + rows.smooth_dps) * DT)
    np.testing.assert_allclose(turned, smoothed - smoothed[0], atol=0.005)
    np.testing.assert_array_equal(rows.gyro_dps, gyro)


@pytest.mark.parametrize(
    ("delay_s", "window_s"), [(0.3, 0.0), (-0.3, 0.0), (0.3, 0.5), (-0.3, 0.5), (0.0, 0.5)]
)
def test_blocks_of_any_size_give_the_same_rows(delay_s: float, window_s: float) -> None:
    robot = replace(ROBOT, gyro=GyroFigures(delay_s=delay_s), encoders=EncoderFigures(window_s=window_s))
    log = columns(0.3)
    log[3][100:103] = np.nan
    whole = aligned(robot, *log)
    for chunk in (1, 7, 333):
        for got, wanted in zip(
            vars(aligned(robot, *log, chunk=chunk)).values(), vars(whole).values(), strict=True
        ):
            np.testing.assert_array_equal(got, wanted)
    assert whole.t_s.size == T.size


def test_rows_come_as_late_as_the_delay_asks() -> None:
    aligner = Aligner(replace(ROBOT, gyro=GyroFigures(delay_s=0.09)))
    given = [aligner.push(*(c[k : k + 1] for c in columns())).t_s.size for k in range(20)]
    assert given == [0] * 5 + [1] * 15


@pytest.mark.parametrize(("delay_s", "window_s"), [(0.1, 0.0), (-0.1, 0.0), (0.0, 0.5), (0.1, 0.5)])
@pytest.mark.parametrize("channel", [1, 3])
def test_a_row_that_lacks_something_is_left_to_the_navigator(
    delay_s: float, window_s: float, channel: int
) -> None:
    robot = replace(ROBOT, gyro=GyroFigures(delay_s=delay_s), encoders=EncoderFigures(window_s=window_s))
    log = columns(max(delay_s, 0.0), max(-delay_s, 0.0))
    whole, lacking = (Navigator(robot, filtering=False) for _ in range(2))
    expected = whole.run(*vars(aligned(robot, *log)).values())
    log[channel][500:1500:20] = np.nan
    found = lacking.run(*vars(aligned(robot, *log)).values())
    assert (found.counts.no_encoders, found.counts.no_gyro) == ((50, 0) if channel == 1 else (0, 50))
    np.testing.assert_allclose(found.heading_deg, expected.heading_deg, atol=0.1)
    np.testing.assert_allclose(found.x_m, expected.x_m, atol=0.02)
