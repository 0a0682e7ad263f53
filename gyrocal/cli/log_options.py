"""The options of the commands that read logs: how a drive's, and which gyro of a log of samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import Any

import click


def _pairs(_: click.Context, __: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    pairs = dict(v.split("=", 1) for v in values if "=" in v)
    if len(pairs) < len(values):
        raise click.BadParameter("give PURPOSE=TOPIC, such as wheels=/odom")
    return pairs


def _topic(_: click.Context, __: click.Parameter, value: str | None) -> str | None:
    return value and value.removeprefix("imu=")


_AXES = click.Choice(["x", "y", "z", "-x", "-y", "-z"])
_DRIVE = (
    click.option(
        "--columns",
        type=click.Path(path_type=Path),
        help="TOML that says which columns of another logger's drive log (one CSV or several) are t_s, gyro_dps, the wheels and so on, "
        "with units and signs; the keys stand in gyrocal/records/columns.py. Not for tables of data sets.",
    ),
    click.option(
        "--topic",
        "topics",
        multiple=True,
        callback=_pairs,
        help="ROS bags: imu=, wheels=, temperature= or truth=TOPIC (of transforms: truth=TOPIC:PARENT:CHILD).",
    ),
    click.option(
        "--axis",
        type=_AXES,
        default="z",
        show_default=True,
        help="ROS bags: the axis of the IMU that the robot turns about, upwards.",
    ),
)


_GYRO = (
    click.option(
        "--columns",
        type=click.Path(path_type=Path),
        help="TOML that maps a foreign CSV's columns, units and signs (t_s, gyro_dps, gyro_temp_c).",
    ),
    click.option("--topic", callback=_topic, help="Of a ROS bag with several IMUs."),
    click.option(
        "--axis", type=_AXES, default="z", show_default=True, help="Axis of an autopilot's log or a bag."
    ),
    click.option(
        "--instance", type=click.IntRange(0), default=0, help="Which gyro of an autopilot's log, from 0."
    ),
)


def drive_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `columns`, `topics` and `axis`."""
    return _with(_DRIVE, command)


def gyro_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say which gyro of a log is meant; the command takes them together, as `choice`."""

    @wraps(command)
    def choosing(
        *args: Any, axis: str, instance: int, topic: str | None, columns: Path | None, **others: Any
    ) -> Any:
        from gyrocal.records.gyro_log import GyroChoice

        return command(*args, choice=GyroChoice(axis, instance, topic, columns), **others)

    return _with(_GYRO, choosing)


def _with(
    options: Sequence[Callable[[Callable[..., Any]], Callable[..., Any]]], command: Callable[..., Any]
) -> Callable[..., Any]:
    for option in reversed(options):
        command = option(command)
    return command
