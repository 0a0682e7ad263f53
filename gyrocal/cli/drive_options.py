"""The options of every command that reads drive logs: how they are to be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


def _pairs(_: click.Context, __: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    pairs = dict(v.split("=", 1) for v in values if "=" in v)
    if len(pairs) < len(values):
        raise click.BadParameter("give PURPOSE=TOPIC, such as wheels=/odom")
    return pairs


_OPTIONS = (
    click.option(
        "--columns",
        type=click.Path(path_type=Path),
        help="TOML that maps a foreign log's columns, units and signs, from one file or several.",
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
        type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
        default="z",
        show_default=True,
        help="ROS bags: the axis of the IMU that the robot turns about, upwards.",
    ),
)


def drive_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `columns`, `topics` and `axis`."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command
