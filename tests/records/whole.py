"""Whole logs in memory, for tests; products read them in blocks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gyrocal.records.bags import Wheels, iterate_bag
from gyrocal.records.columns import ColumnMap
from gyrocal.records.drive import DriveBlock, join
from gyrocal.records.drive_log import iterate_drive_log


def read_bag(path: Path, wheels: Wheels, topics: Mapping[str, str] | None = None) -> DriveBlock:
    """A bag; see `iterate_bag`."""
    return join(iterate_bag(path, wheels, topics))


def read_drive_log(
    path: Path, metres_per_tick: tuple[float, float] | None = None, columns: ColumnMap | None = None
) -> DriveBlock:
    """A drive log; see `iterate_drive_log`."""
    return join(iterate_drive_log(path, metres_per_tick, columns))
