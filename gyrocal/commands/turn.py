"""`gyrocal turn` and `gyrocal umbmark`: a log of turns, or the ends of squares, read and calibrated by."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gyrocal.calibration.turns import calibrate_turns
from gyrocal.errors import DataError, InputError
from gyrocal.navigation.umbmark import Umbmark, umbmark
from gyrocal.records.csvio import read_columns, read_header, require_columns
from gyrocal.records.gyro_log import ALL_EMPTY, GyroChoice, iterate_gyro_log
from gyrocal.records.output import check_output, write_directory
from gyrocal.records.robot import read_robot
from gyrocal.report.turns import TurnReport, turn_files
from gyrocal.units import plural

_SQUARES = ("direction", "x_m", "y_m")


def examine_turns(log: Path, mark_deg: float, choice: GyroChoice | None = None) -> TurnReport:
    """Read a log of samples and calibrate by its turns.

    Raises
    ------
    InputError, DataError
        A log that cannot be read, or without three turns between rests.
    """
    blocks = list(iterate_gyro_log(log, choice))
    numbers = np.concatenate([np.full(len(b), b.segment) for b in blocks])
    t_s, gyro = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("t_s", "gyro_dps"))
    notes = [note for block in blocks for note in block.notes]
    here = numbers == np.bincount(numbers).argmax()
    if beyond := int(np.count_nonzero(~here)):
        notes.append(
            plural(beyond, f"{beyond} [sample|samples] beyond a step of the clock [is|are] left out")
        )
    known = np.isfinite(gyro)
    if empty := int(np.count_nonzero(here & ~known)):
        notes.append(plural(empty, f"{empty} empty [sample is|samples are] bridged by the next one"))
    use = here & known
    if np.count_nonzero(use) < 2:
        raise DataError(f"{log}: has no samples to look for turns in: {ALL_EMPTY}")
    try:
        found = calibrate_turns(t_s[use], gyro[use], mark_deg)
    except DataError as error:
        raise DataError(f"{log}: {error}") from error
    return TurnReport(found, t_s[use], gyro[use], tuple(notes))


def write_turns(report: TurnReport, out: Path) -> None:
    """JSON and picture into the new directory `out`."""
    check_output(out)
    write_directory(out, turn_files(report))


def examine_squares(runs: Path, robot: Path, side_m: float, seed: int) -> Umbmark:
    """Read return errors and correct the robot file's figures.

    Parameters
    ----------
    runs : CSV with ``direction, x_m, y_m``: +1 counter-clockwise, -1 clockwise; measured less believed end position

    Raises
    ------
    InputError, ProfileError, DataError
        A file that cannot be read, another direction, or too few runs.
    """
    header = read_header(runs)
    require_columns(runs, header, _SQUARES, _SQUARES)
    table = read_columns(runs, header)
    points = np.column_stack([table["x_m"], table["y_m"]])
    for row, values in enumerate(np.column_stack([table["direction"], points])):
        if abs(values[0]) != 1.0 or not np.isfinite(values).all():
            shown = ", ".join(f"{v:g}" for v in values)
            raise InputError(
                f"{runs}, line {row + 2}: holds {shown}; wanted are a direction of 1 or -1 and two distances in metres."
            )
    ccw = table["direction"] > 0
    vehicle = read_robot(robot)
    vehicle.check_sides()
    return umbmark(points[~ccw], points[ccw], side_m, vehicle.parameters, seed)
