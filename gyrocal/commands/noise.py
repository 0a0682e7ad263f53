"""`gyrocal noise`: a record at rest, examined and drawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gyrocal.calibration.static import StaticConfig, StaticFigures, examine_static
from gyrocal.records.output import check_output, write_directory
from gyrocal.report.noise import noise_files


def examine_noise(
    config: StaticConfig, out: Path | None, progress: Callable[[float, str], None]
) -> StaticFigures:
    """Examine a record, and write what was found to `out` if it is given.

    Raises
    ------
    InputError, DataError, OutputError
        Nothing is written then.
    """
    if out is not None:
        check_output(out)
    found = examine_static(config, progress)
    if out is not None:
        progress(0.9, "pictures")
        write_directory(out, noise_files(found))
    progress(1.0, "")
    return found
