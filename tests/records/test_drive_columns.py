"""Column mapping of foreign logs: units and signs as stated, nothing guessed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import InputError
from gyrocal.records.columns import read_column_map
from tests.records.whole import read_drive_log

TIME = '[columns.t_s]\nfrom = "stamp"\nunit = "ms"\n'
LEFT = '[columns.left_m]\nfrom = "encL"\nunit = "ticks_total"\nwrap = 65536\n'
RIGHT = '[columns.right_m]\nfrom = "encR"\nunit = "ticks_total"\nsign = -1\nwrap = 65536\n'
GYRO = '[columns.gyro_dps]\nfrom = "yaw"\nunit = "rad/s"\nsign = -1\n'
ALL = TIME + LEFT + RIGHT + GYRO


def write(tmp_path: Path, text: str, name: str = "map.toml") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def test_units_signs_and_wrapping_counters(tmp_path: Path) -> None:
    extra = '[columns.gyro_temp_c]\nfrom = "temp"\nunit = "F"\n[columns.truth_heading_deg]\nfrom = "compass"\nunit = "deg"\nsign = -1\noffset = 90\n'
    columns = read_column_map(write(tmp_path, ALL + extra))
    log = write(
        tmp_path,
        "frame,stamp,encL,encR,yaw,temp,compass\nbase,1000,65530,10,0.5,68,0\nbase,1100,4,65533,-0.1,50,90\n",
        "log.csv",
    )
    block = read_drive_log(log, (0.5, 0.25), columns)
    np.testing.assert_allclose(block.t_s, [1.0, 1.1])
    np.testing.assert_allclose(block.left_m, [0.0, 5.0])
    np.testing.assert_allclose(block.right_m, [0.0, 13 * 0.25])
    np.testing.assert_allclose(block.gyro_dps, np.degrees([-0.5, 0.1]))
    np.testing.assert_allclose(block.gyro_temp_c, [20.0, 10.0])
    np.testing.assert_allclose(block.truth_heading_deg, [90.0, 0.0])
    assert np.isnan(block.truth_x_m).all()


@pytest.mark.parametrize(
    ("unit", "cells", "steps_m"),
    [
        ("m", (0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
        ("mm", (100, 200, 300), (0.1, 0.2, 0.3)),
        ("m_total", (5.0, 5.2, 5.5), (0.0, 0.2, 0.3)),
        ("mm_total", (5000, 5200, 5500), (0.0, 0.2, 0.3)),
        ("ticks", (10, 20, 30), (0.1, 0.2, 0.3)),
        ("m/s", (9.0, 2.0, 3.0), (0.0, 0.2, 0.3)),
        ("km/h", (9.0, 7.2, 10.8), (0.0, 0.2, 0.3)),
    ],
)
def test_every_unit_of_distance(
    tmp_path: Path, unit: str, cells: tuple[float, ...], steps_m: tuple[float, ...]
) -> None:
    sides = "".join(f'[columns.{side}]\nfrom = "d"\nunit = "{unit}"\n' for side in ("left_m", "right_m"))
    columns = read_column_map(write(tmp_path, TIME + GYRO + sides))
    rows = "".join(f"{100 * k},{c},0\n" for k, c in enumerate(cells))
    log = write(tmp_path, "stamp,d,yaw\n" + rows, "log.csv")
    for chunk in (read_drive_log(log, (0.01, 0.01), columns),):
        np.testing.assert_allclose(chunk.left_m, steps_m, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            TIME + LEFT + RIGHT,
            "[columns.gyro_dps] is missing; required: t_s, gyro_dps, and left_m and right_m, or speed_m.",
        ),
        (ALL + "[columns.speed]\nfrom = 'a'\nunit = 'm'\n", "no such column in a drive log; allowed: t_s"),
        (ALL.replace('"rad/s"', '"rad"'), "unit is 'rad'; allowed: deg/s, rad/s, mdeg/s, deg/h."),
        (TIME + LEFT + RIGHT + '[columns.gyro_dps]\nfrom = "yaw"\n', "unit is None; allowed: deg/s"),
        (ALL.replace('from = "yaw"\n', ""), "from is missing; it names the column of the foreign log."),
        (ALL.replace("sign = -1", "sign = 2"), "sign is 2; allowed: 1, -1."),
        (
            ALL.replace("sign = -1", "scale = 2"),
            "unknown key 'scale'; allowed: from, unit, sign, offset, wrap, file, time.",
        ),
        (ALL + "wrap = 5\n", "wrap is the positive modulus of a counter (unit m_total or ticks_total)."),
        (ALL + "offset = 'a'\n", "offset is 'a', and a finite number is wanted."),
        (ALL + "file = 'g.csv'\n", "[columns.gyro_dps]: file is for what is not in the log itself."),
        (ALL + "time = 't'\n", "time is the column of time in another file, and no file is named."),
        (ALL + '[columns.speed_m]\nfrom = "v"\nunit = "m/s"\n', "has both speed_m and a side."),
        (
            ALL + '[columns.truth_heading_deg]\nfrom = ["x", "y"]\nunit = "quaternion"\n',
            "from is a list of four columns x, y, z, w for a quaternion.",
        ),
        (ALL + f"offset = {'9' * 400}\n", "a finite number is wanted."),
        (ALL.replace('"rad/s"', "['rad/s']"), "unit is ['rad/s']; allowed: deg/s"),
        ("a = " + "[" * 5000, "is not TOML"),
        ("a = 1\n" + ALL, "unknown key 'a'; allowed: columns"),
        ("columns = 1\n", "columns must be tables"),
        ("[columns]\nt_s = 1\n", "is not a table with from"),
        ("[columns", "is not TOML"),
    ],
)
def test_bad_mappings_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        read_column_map(write(tmp_path, text))
    assert message in str(error.value)


def test_a_mapped_column_must_be_there(tmp_path: Path) -> None:
    columns = read_column_map(write(tmp_path, ALL))
    log = write(tmp_path, "stamp,encL,encR,gyro\n0,0,0,0\n", "log.csv")
    with pytest.raises(InputError, match="column 'yaw', mapped to gyro_dps, is missing"):
        read_drive_log(log, (1.0, 1.0), columns)
