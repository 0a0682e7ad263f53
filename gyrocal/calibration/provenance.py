"""What must not be mixed: coefficients of another sensor, and rates that were compensated already."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gyrocal.errors import CoefficientError, DataError, InputError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.records.files import reading, sha256_of_file
from gyrocal.records.run import Run, Sensor, read_run

#: What a table of data sets, which does not name its sensor, is filed under.
UNKNOWN = "unknown"


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the coefficient file's name before what is wrong with the coefficients read from it."""
    try:
        yield
    except CoefficientError as error:
        raise CoefficientError(f"{path}: {error}") from error


def refuse_compensated(run: Run) -> None:
    """Refuse a run whose ``run.json`` says that its rates went through a calibration already.

    Raises
    ------
    DataError
        It does: a second calibration or correction on top of the first would be wrong without a sign of it.
    """
    if run.compensated:
        by = "" if run.compensated is True else f" (by {run.compensated})"
        raise DataError(
            f"{run.path / 'run.json'}: says that its rates are compensated already{by}. Use the raw record of the gyro."
        )


def check_sensor(
    coefficients: Mapping[str, Any], recording: Mapping[str, Any], source: Path, *, force: bool = False
) -> tuple[str, ...]:
    """Refuse coefficients of another gyro.

    Parameters
    ----------
    coefficients, recording : mapping
        The ``sensor`` entries: ``model`` and ``serial``, where they are known.
    source : Path
        The recording, for the message.
    force : bool
        Do not refuse, but note it.

    Returns
    -------
    notes : tuple of str
        What could not be checked, or was overridden.

    Raises
    ------
    CoefficientError
        Model or serial number differ.
    """
    unknown, notes = [], []
    for key in ("model", "serial"):
        theirs, ours = coefficients.get(key), recording.get(key)
        if theirs in (None, UNKNOWN) or ours in (None, UNKNOWN):
            unknown.append(key)
        elif theirs != ours and force:
            notes.append(f"{key} differs: recording {ours}, coefficients {theirs} (--force-sensor)")
        elif theirs != ours:
            raise CoefficientError(
                f"{source}: was recorded with {key} {ours}, and the coefficients are those of {key} {theirs}. "
                "Use coefficients of the same gyro, or say --force-sensor."
            )
    if unknown:
        notes.append(
            f"whether this is the same gyro was not checked by {' and '.join(unknown)}: not stated in both files"
        )
    return tuple(notes)


def source_sha256(path: Path) -> str:
    """Checksum of a recording: of the table's bytes, or of ``run.json`` and the journal, which holds that of each segment."""
    if not path.is_dir():
        with reading(path):
            return sha256_of_file(path)
    digest = hashlib.sha256()
    for name in ("run.json", "journal.jsonl"):
        with reading(path / name):
            digest.update((path / name).read_bytes())
    return digest.hexdigest()


def refuse_twice(paths: Sequence[Path]) -> None:
    """Refuse a recording that is given twice, be it under two names: it repeats itself exactly, which no measurement does.

    Raises
    ------
    DataError
        With both names.
    """
    seen: dict[str, Path] = {}
    for path in paths:
        try:
            checksum = source_sha256(path)
        except InputError:  # said where it is read
            continue
        if checksum in seen:
            raise DataError(f"{path} and {seen[checksum]} are the same recording: give each once.")
        seen[checksum] = path


def sensor_of(path: Path) -> Sensor:
    """The sensor that a run directory names, without its data; `UNKNOWN` of a table, and of what cannot be read."""
    with contextlib.suppress(InputError):  # said where it is read
        if path.is_dir():
            return read_run(path).sensor
    return Sensor(UNKNOWN)


def refuse_units(paths: Sequence[Path], purpose: str, *, unnamed: bool) -> None:
    """Refuse runs of several units, before any of them is fitted.

    Parameters
    ----------
    purpose : what is of one unit, for the message
    unnamed : whether one without a serial number may not be of the same unit as others that have one

    Raises
    ------
    DataError
        With the serial numbers.
    """
    serials = {sensor_of(path).serial or "" for path in paths}
    units = sorted(serial for serial in serials if serial or unnamed)
    if len(units) > 1:
        shown = ", ".join(serial or "no serial number" for serial in units)
        raise DataError(
            f"The runs are of several units ({shown}): {purpose} is of one. Use `fleet` for many."
        )


def fitted_to(coefficients: Coefficients, path: Path) -> Coefficients:
    """The coefficients with the recording that they were fitted to in their provenance."""
    source = {"source": path.name, "source_sha256": source_sha256(path)}
    return replace(coefficients, provenance=dict(coefficients.provenance) | source)
