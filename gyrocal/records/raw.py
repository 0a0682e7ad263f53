"""Raw captures, ``gyrocal-raw/1``: the bytes of a port with their arrival times, to be decoded again later.

The first line is JSON: ``schema``, ``device`` and its ``options``. Each further line is a time in seconds since the
run began and the bytes in hexadecimal; ``>`` before the bytes marks what was sent to the device.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from gyrocal.errors import InputError
from gyrocal.records.files import raise_output_error, reading

SCHEMA = "gyrocal-raw/1"
#: No chunk of a port is longer; a file that has no lines is not read whole.
_LONGEST_LINE = 1 << 24


class RawWriter:
    """A capture that is being written; every chunk is a line of its own, so a crash costs at most the last one."""

    def __init__(self, path: Path, device: str, options: Mapping[str, Any]) -> None:
        self._path = path
        try:
            self._file: IO[str] = path.open("x", encoding="ascii")
        except OSError as error:
            raise_output_error(path, error)
        self._write(
            json.dumps({"schema": SCHEMA, "device": device, "options": dict(options)}, sort_keys=True)
        )

    def chunk(self, t_s: float, data: bytes, *, sent: bool = False) -> None:
        """Add bytes that arrived, or were `sent`, at `t_s`."""
        self._write(f"{t_s:.6f} {'>' if sent else ''}{data.hex()}")

    def flush(self) -> None:
        """Hand what is buffered to the operating system, so that it outlives this program."""
        try:
            self._file.flush()
        except OSError as error:
            raise_output_error(self._path, error)

    def close(self) -> None:
        """Flush and close."""
        try:
            self._file.close()
        except OSError as error:
            raise_output_error(self._path, error)

    def _write(self, line: str) -> None:
        try:
            self._file.write(line + "\n")
        except OSError as error:
            raise_output_error(self._path, error)


def read_raw_head(path: Path) -> dict[str, Any]:
    """First line of a capture: ``device`` and ``options``.

    Raises
    ------
    InputError
        Not a raw capture, or of another schema.
    """
    with reading(path), path.open(encoding="ascii") as f:
        line = f.readline(_LONGEST_LINE)
    try:
        head = json.loads(line)
    except (ValueError, RecursionError):
        head = None
    if not _is_head(head):
        raise InputError(f"{path}, line 1: is not a raw capture ({SCHEMA}). Check that it is the right file.")
    return dict(head)


def _is_head(head: Any) -> bool:
    if not isinstance(head, dict) or head.get("schema") != SCHEMA:
        return False
    return isinstance(head.get("device"), str) and isinstance(head.get("options", {}), dict)


def is_cut_off(path: Path) -> bool:
    """Whether a capture ends in the middle of a line: by a crash, or a copy that was not finished."""
    with reading(path), path.open("rb") as f:
        f.seek(-1, os.SEEK_END)
        return f.read(1) != b"\n"


def iterate_raw(path: Path) -> Iterator[tuple[float, bytes]]:
    """Yield ``(arrival time in s, bytes)`` of what the device sent, in bounded memory.

    Raises
    ------
    InputError
        A line that is neither; one cut off at the very end by a crash is left out.
    """
    read_raw_head(path)
    with reading(path), path.open(encoding="ascii") as f:
        f.readline()
        for number, line in enumerate(f, start=2):
            if not line.endswith("\n"):
                return
            time_text, _, hexadecimal = line.strip().partition(" ")
            try:
                t_s, data = float(time_text), bytes.fromhex(hexadecimal.removeprefix(">"))
            except ValueError as error:
                raise InputError(
                    f"{path}, line {number}: is not a time and bytes. Repair or remove the line."
                ) from error
            if not hexadecimal.startswith(">"):
                yield t_s, data
