"""Vehicles that log a speed, streams of different rates, several files, quaternions, and clocks that step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import DataError, InputError
from gyrocal.records.columns import read_column_map
from gyrocal.records.drive import format_drive_log, join
from gyrocal.records.drive_log import iterate_drive_log
from tests.records.whole import read_drive_log

#: A drive in closed form: speed and turn rate vary slowly beside every sampling interval.
DURATION_S, SEPARATION_M = 60.0, 0.5


def way_m(t_s: np.ndarray) -> np.ndarray:
    return np.asarray(1.5 * t_s + 2.0 * (1.0 - np.cos(0.2 * t_s)))


def heading_deg(t_s: np.ndarray) -> np.ndarray:
    return np.asarray(40.0 * np.sin(0.1 * t_s))


def rate_dps(t_s: np.ndarray) -> np.ndarray:
    return np.asarray(4.0 * np.cos(0.1 * t_s))


def csv(tmp_path: Path, header: str, rows: list[str], name: str = "drive.csv") -> Path:
    path = tmp_path / name
    path.write_text(header + "\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("column", ["speed_mps", "speed_m"])
def test_one_speed_is_the_way_and_says_that_it_has_no_sides(tmp_path: Path, column: str) -> None:
    t_s = np.arange(0.0, DURATION_S, 0.01)
    steps_m = np.diff(way_m(t_s), prepend=0.0)
    cells = steps_m if column == "speed_m" else steps_m / 0.01
    rows = [f"{t:.2f},{c:.9f},{g:.6f},20,3.5" for t, c, g in zip(t_s, cells, rate_dps(t_s), strict=True)]
    log = read_drive_log(csv(tmp_path, f"t_s,{column},gyro_dps,gyro_temp_c,steering_deg", rows))
    assert log.speed_only
    np.testing.assert_allclose(np.cumsum(log.left_m), way_m(t_s), atol=1e-5)
    np.testing.assert_array_equal(log.left_m, log.right_m)
    np.testing.assert_array_equal(log.steering_deg, 3.5)
    again = tmp_path / "again.csv"
    again.write_text(format_drive_log(log))
    assert read_drive_log(again).speed_only


def test_two_sides_are_not_one_speed(tmp_path: Path) -> None:
    log = read_drive_log(csv(tmp_path, "t_s,left_m,right_m,gyro_dps,gyro_temp_c", ["0,0,0,1,", "1,1,1,1,"]))
    assert not log.speed_only
    assert np.isnan(log.steering_deg).all()
    assert log.notes == ()


def mixed_rows(wheel_step: int, *, apart: bool) -> tuple[np.ndarray, list[str]]:
    """Gyro at 100 Hz, wheels each `wheel_step` rows: in rows of the gyro, or between them."""
    t_s = np.arange(0.0, DURATION_S, 0.01)
    half = 0.5 * SEPARATION_M * np.radians(heading_deg(t_s))
    rows = []
    shift = 0.004 if apart else 0.0
    for k, t in enumerate(t_s):
        wheels = ","
        if k % wheel_step == 0:
            at = np.array([t + shift])
            turn = float(0.5 * SEPARATION_M * np.radians(heading_deg(at))[0])
            wheels = f"{way_m(at)[0] - turn:.9f},{way_m(at)[0] + turn:.9f}"
        if apart and wheels != ",":
            rows += [f"{t:.3f},,,{rate_dps(t_s)[k]:.6f},20", f"{t + shift:.3f},{wheels},,"]
        else:
            rows.append(f"{t:.3f},{wheels},{rate_dps(t_s)[k]:.6f},20")
    return np.stack((way_m(t_s) - half, way_m(t_s) + half)), rows


TOTALS = """
[columns.t_s]
from = "t"
unit = "s"
[columns.gyro_dps]
from = "g"
unit = "deg/s"
[columns.gyro_temp_c]
from = "temp"
unit = "C"
"""
SIDES = '[columns.left_m]\nfrom = "l"\nunit = "m_total"\n[columns.right_m]\nfrom = "r"\nunit = "m_total"\n'


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("wheel_step", [5, 20])
@pytest.mark.parametrize("chunk_rows", [317, 100_000])
def test_wheels_slower_than_the_gyro_are_laid_on_its_times(
    tmp_path: Path, apart: bool, wheel_step: int, chunk_rows: int
) -> None:
    totals_m, rows = mixed_rows(wheel_step, apart=apart)
    columns = tmp_path / "map.toml"
    columns.write_text(TOTALS + SIDES)
    path = csv(tmp_path, "t,l,r,g,temp", rows)
    log = join(iterate_drive_log(path, None, read_column_map(columns), chunk_rows))
    grid = np.round(log.t_s / 0.01).astype(int)
    assert len(log) > DURATION_S / 0.01 - wheel_step - 1
    np.testing.assert_allclose(log.gyro_dps, rate_dps(0.01 * grid), atol=1e-5)
    # Linear interpolation over h errs by at most h^2/8 times the second derivative (here below 0.2 m/s^2).
    bound_m = (0.01 * wheel_step) ** 2 / 8 * 0.2
    for steps_m, total_m in zip((log.left_m, log.right_m), totals_m, strict=True):
        np.testing.assert_allclose(np.cumsum(steps_m), (total_m - total_m[grid[0]])[grid], atol=2 * bound_m)
    assert "laid on the gyro's times by interpolation" in log.notes[0]


def test_a_gyro_slower_than_the_wheels_loses_no_way(tmp_path: Path) -> None:
    t_s = np.arange(0.0, DURATION_S, 0.01)
    rows = [f"{t:.2f},0.01,0.01,{'1.0' if k % 10 == 0 else ''},20" for k, t in enumerate(t_s)]
    log = read_drive_log(csv(tmp_path, "t_s,left_m,right_m,gyro_dps,gyro_temp_c", rows))
    np.testing.assert_allclose(np.diff(log.t_s), 0.1, atol=1e-9)
    np.testing.assert_allclose(log.left_m[1:], 0.1)


def test_streams_of_two_files(tmp_path: Path) -> None:
    t_s = np.arange(0.0, DURATION_S, 0.01)
    wheels_s = np.arange(0.003, DURATION_S, 0.05)
    csv(
        tmp_path,
        "stamp,v",
        [f"{t:.4f},{v:.9f}" for t, v in zip(wheels_s, way_m(wheels_s), strict=True)],
        "w.csv",
    )
    gyro = csv(tmp_path, "t,g,temp", [f"{t:.4f},{g:.6f},20" for t, g in zip(t_s, rate_dps(t_s), strict=True)])
    columns = tmp_path / "map.toml"
    speed = '[columns.speed_m]\nfrom = "v"\nunit = "m_total"\nfile = "w.csv"\ntime = "stamp"\n'
    columns.write_text(TOTALS + speed)
    for chunk_rows in (100, 100_000):
        log = join(iterate_drive_log(gyro, None, read_column_map(columns), chunk_rows))
        assert log.speed_only
        way = way_m(log.t_s)
        np.testing.assert_allclose(np.cumsum(log.left_m), way - way[0], atol=2e-4)
        assert log.notes[-1].endswith("of the wheels are left out")
    columns.write_text(TOTALS + speed.replace("w.csv", "none.csv"))
    with pytest.raises(InputError, match=r"none.csv: no such file"):
        read_drive_log(gyro, None, read_column_map(columns))


def test_files_of_two_clocks_are_refused(tmp_path: Path) -> None:
    csv(tmp_path, "t,v", [f"{5000 + 0.1 * k},1" for k in range(50)], "w.csv")
    gyro = csv(tmp_path, "t,g,temp", [f"{0.1 * k},1,20" for k in range(50)])
    columns = tmp_path / "map.toml"
    columns.write_text(TOTALS + '[columns.speed_m]\nfrom = "v"\nunit = "m_total"\nfile = "w.csv"\n')
    with pytest.raises(DataError, match="gyro and wheels do not overlap in time; they are not of one clock"):
        read_drive_log(gyro, None, read_column_map(columns))


def test_a_heading_from_a_quaternion(tmp_path: Path) -> None:
    angles = np.radians([0.0, 30.0, -135.0, 179.0])
    rows = [f"{k},0,0,0,20,0,0,{np.sin(a / 2):.9f},{np.cos(a / 2):.9f}" for k, a in enumerate(angles)]
    header = "t_s,left_m,right_m,gyro_dps,gyro_temp_c,truth_qx,truth_qy,truth_qz,truth_qw"
    log = read_drive_log(csv(tmp_path, header, rows))
    np.testing.assert_allclose(log.truth_heading_deg, np.degrees(angles), atol=1e-5)
    with pytest.raises(InputError, match=r"line 2: the quaternion .* has the length 0, and 1 is wanted"):
        read_drive_log(csv(tmp_path, header, ["0,0,0,0,20,0,0,0,0"]))


@pytest.mark.parametrize("chunk_rows", [700, 100_000])
def test_a_clock_that_jumps_to_unix_time_is_closed_and_said(tmp_path: Path, chunk_rows: int) -> None:
    t_s = np.arange(0.0, 50.0, 0.01)
    logged = np.where(t_s < 10.0, t_s, t_s + 1.7e9)
    rows = [f"{t:.3f},0.01,0.01,1,20" for t in logged]
    path = csv(tmp_path, "t_s,left_m,right_m,gyro_dps,gyro_temp_c", rows)
    log = join(iterate_drive_log(path, chunk_rows=chunk_rows))
    np.testing.assert_allclose(log.t_s, t_s, atol=1e-5)
    assert np.flatnonzero(np.diff(log.segment)).tolist() == [999]
    (note,) = log.notes
    assert note.startswith("line 1002: time steps by 1.7e+09 s, where rows come every 0.01 s; the clock")


def test_a_short_loss_of_samples_is_no_step_of_the_clock(tmp_path: Path) -> None:
    t_s = np.concatenate((np.arange(0.0, 20.0, 0.01), np.arange(28.0, 40.0, 0.01)))
    path = csv(tmp_path, "t_s,left_m,right_m,gyro_dps,gyro_temp_c", [f"{t:.2f},0,0,1,20" for t in t_s])
    log = read_drive_log(path)
    assert log.notes == ()
    np.testing.assert_allclose(log.t_s, t_s)


@pytest.mark.parametrize(
    ("start", "step", "unit"),
    [
        (1.7e18, 1e7, "ns"),
        (1.7e15, 1e4, "us"),
        (1.7e12, 10.0, "ms"),
        (1.7e12, 1.0, "ms"),
        (0.0, 1e7, "ns"),
        (0.0, 1e4, "us"),
        (0.0, 10.0, "ms"),
    ],
)
def test_times_in_another_unit_are_refused_with_the_remedy(
    tmp_path: Path, start: float, step: float, unit: str
) -> None:
    rows = [f"{start + k * step:.0f},0,0,1,20" for k in range(100)]
    with pytest.raises(InputError) as error:
        read_drive_log(csv(tmp_path, "t_s,left_m,right_m,gyro_dps,gyro_temp_c", rows))
    assert f'say its unit in a mapping with --columns: [columns.t_s] with unit = "{unit}".' in str(
        error.value
    )


def test_positions_as_angles_are_refused_with_the_remedy(tmp_path: Path) -> None:
    path = csv(tmp_path, "t_s,left_m,right_m,gyro_dps,latitude_deg,longitude_deg", ["0,0,0,1,47,8"])
    with pytest.raises(InputError, match="project them to metres, east as truth_x_m, north as truth_y_m"):
        read_drive_log(path)


@pytest.mark.parametrize("chunk_rows", [7, 10_000])
def test_a_row_without_a_speed_is_left_to_the_navigator_and_its_way_is_not_told_again(
    tmp_path: Path, chunk_rows: int
) -> None:
    """It holds the last speed there; a path with 3 % of such rows had been 3 % too long."""
    path = tmp_path / "speed.csv"
    cells = ["" if k in (30, 31, 60) else "2" for k in range(100)]
    rows = [f"{0.1 * k:.1f},0,{cell}" for k, cell in enumerate(cells)]
    path.write_text("t_s,gyro_dps,speed_mps\n" + "\n".join(rows) + "\n")
    way_m = np.concatenate([block.left_m for block in iterate_drive_log(path, chunk_rows=chunk_rows)])
    assert np.flatnonzero(np.isnan(way_m)).tolist() == [30, 31, 60]
    np.testing.assert_allclose(way_m[[32, 61, 99]], 0.2, atol=1e-9)
