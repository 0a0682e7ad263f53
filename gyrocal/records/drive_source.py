"""A drive log of whatever kind: our CSV, a foreign one by its mapping, or a ROS bag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gyrocal.errors import InputError
from gyrocal.records.bags import Wheels, is_bag, iterate_bag
from gyrocal.records.columns import read_column_map
from gyrocal.records.drive import DriveBlock, join
from gyrocal.records.drive_log import iterate_drive_log
from gyrocal.records.robot import Robot


@dataclass(frozen=True)
class Reading:
    """How logs are to be read, as far as they do not say it themselves.

    Attributes
    ----------
    columns : Path or None
        Mapping of the columns of a foreign CSV.
    topics : mapping
        Of a bag: purpose to topic.
    axis : str
        Of a bag: the axis of its IMU that the robot turns about: x, y or z; a minus before it makes counter-clockwise positive.
    """

    columns: Path | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    axis: str = "z"


def iterate_drive(path: Path, robot: Robot, reading: Reading | None = None) -> Iterator[DriveBlock]:
    """Yield the drive `path` in blocks; see `iterate_drive_log` and `iterate_bag`, and what they raise.

    Raises
    ------
    InputError
        Topics or an axis for what is no bag, columns for what is none but a bag.
    ProfileError
        The log tells left from right, and the robot file lacks the wheel separation.
    """
    how = reading or Reading()
    if is_bag(path):
        if how.columns is not None:
            raise InputError(f"{path}: is a bag, and --columns is for CSV. Leave it out.")
        wheels = Wheels(robot.wheel_separation_m, robot.wheel_radius_m, how.axis)
        return _sided(iterate_bag(path, wheels, how.topics), robot)
    if how.topics or how.axis != "z":
        raise InputError(
            f"{path}: is no ROS bag; --topic and --axis are for those. Map columns with --columns."
        )
    columns = None if how.columns is None else read_column_map(how.columns)
    return _sided(iterate_drive_log(path, robot.metres_per_tick, columns), robot)


def _sided(blocks: Iterator[DriveBlock], robot: Robot) -> Iterator[DriveBlock]:
    """The blocks, of a robot whose file has what the first of them needs."""
    for block in blocks:
        if not block.speed_only:
            robot.check_sides()
        yield block


def read_drive(path: Path, robot: Robot, reading: Reading | None = None) -> DriveBlock:
    """The whole drive in memory; see `iterate_drive`."""
    return join(iterate_drive(path, robot, reading))
