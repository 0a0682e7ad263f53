"""A directory of results that is there wholly or not at all."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from gyrocal.errors import OutputError
from gyrocal.records.files import fsync_directory, make_output_directory, raise_output_error, write_atomically


def check_output(path: Path) -> None:
    """Refuse, before the work, an output directory that holds files or cannot be made."""
    existed = path.exists()
    make_output_directory(path)
    if not existed:
        # What is made again at the end would be an empty directory if the work failed in between.
        with contextlib.suppress(OSError):
            path.rmdir()


def write_directory(path: Path, files: Mapping[str, bytes | str]) -> None:
    """Write `files` (names relative to `path`) beside `path`, then rename them into place in one step.

    Raises
    ------
    OutputError
        `path` holds files, cannot be written, or the disk is full; nothing new is left behind then.
    """
    make_output_directory(path)
    try:
        staging = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
        try:
            for name, data in files.items():
                target = staging / name
                target.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(target, data)
            staging.chmod(path.stat().st_mode)
            staging.replace(path)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            with contextlib.suppress(OSError):
                path.rmdir()
            raise
        fsync_directory(path.parent)
    except OSError as error:
        raise_output_error(path, error)
    except OutputError as error:
        # It names a file in the staging directory, which is gone by now.
        if isinstance(error.__cause__, OSError):
            raise_output_error(path, error.__cause__)
        raise
