"""Files that are either wholly there or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NoReturn

from gyrocal.errors import GyrocalError, InputError, OutputError

_NO_SPACE = {errno.ENOSPC, errno.EDQUOT}


#: What there is after an error, and what to do.
_NOTHING_LEFT = "nothing was left half-written. Free some space and run it again"


def raise_output_error(path: Path, error: OSError, when_full: str = _NOTHING_LEFT) -> NoReturn:
    """Turn an ``OSError`` met while writing `path` into one sentence with a remedy.

    `when_full` says what a full disk leaves behind, and how to go on.
    """
    if error.errno in _NO_SPACE:
        msg = f"{path}: the disk is full; {when_full}."
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        msg = f"{path}: cannot write here ({error.strerror}). Choose another place or change its permissions."
    else:
        msg = f"{path}: cannot write ({error.strerror or error}). Choose another place."
    raise OutputError(msg) from error


def fsync_directory(path: Path) -> None:
    """Make a rename or a new name in directory `path` survive a power cut (POSIX; no-op elsewhere)."""
    if os.name != "posix":
        return
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


@contextlib.contextmanager
def writing_atomically(path: Path) -> Iterator[IO[bytes]]:
    """Yield a file that becomes `path` when the block ends well: temporary file beside it, fsync, rename.

    Raises
    ------
    OutputError
        The directory is missing, read-only, or the disk is full. `path` is then as it was before.
    """
    try:
        fd, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        try:
            with os.fdopen(fd, "wb") as f:
                yield f
                f.flush()
                os.fsync(f.fileno())
            umask = os.umask(0)
            os.umask(umask)
            Path(temporary).chmod(0o666 & ~umask)
            Path(temporary).replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(temporary).unlink()
            raise
        fsync_directory(path.parent)
    except OSError as error:
        raise_output_error(path, error)


def write_atomically(path: Path, data: bytes | str) -> None:
    """Write `data` to `path`, wholly or not at all; see `writing_atomically`."""
    with writing_atomically(path) as f:
        f.write(data.encode() if isinstance(data, str) else data)


def check_output_file(path: Path, *, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse, before the work, an output that must not be written.

    Parameters
    ----------
    inputs : iterable of Path
        What the command reads: no output replaces one of them, or lies in one that is a directory.

    Raises
    ------
    OutputError
        `path` is an input or lies in one, is a directory, or exists and may not be overwritten.
    """
    if any(path.resolve().is_relative_to(read.resolve()) for read in inputs):
        raise OutputError(f"{path}: is an input of this command, or lies in it. Choose another --output.")
    if path.is_dir():
        raise OutputError(f"{path}: is a directory, and a file is wanted here. Choose another --output.")
    if path.exists() and not overwrite:
        msg = f"{path}: exists; nothing was overwritten. Choose another --output or say --overwrite."
        raise OutputError(msg)


def make_output_directory(path: Path, *, may_hold_files: bool = False) -> None:
    """Create the directory `path`; refuse one that already holds files unless `may_hold_files`."""
    try:
        if path.exists() and not path.is_dir():
            msg = f"{path}: is a file, and a directory is wanted here. Choose another --out."
            raise OutputError(msg)
        if path.is_dir() and not may_hold_files and any(path.iterdir()):
            msg = f"{path}: exists and is not empty; nothing was overwritten. Choose another --out or remove it."
            raise OutputError(msg)
        path.mkdir(parents=True, exist_ok=True)
        # A directory may exist and still refuse files: better to learn it before the work than after.
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise_output_error(path, error)


def sha256_of_file(path: Path) -> str:
    """Hex digest of a file's bytes, read in blocks."""
    digest = hashlib.sha256()
    with path.open("rb") as f:
        for block in iter(lambda: f.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()


def _what_directory(path: Path) -> str:
    """The end of the sentence about a directory where a file was wanted: what it is, and what to do."""
    if (path / "run.json").exists():
        return ". It holds a run of the bench: `fit` and `diagnose` take it as it is, without --robot."
    return ". Give the path of a file in it."


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what the operating system says about reading `path` into an ``InputError`` with a remedy."""
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file or directory. Check the path.") from error
    except IsADirectoryError as error:
        msg = f"{path}: is a directory, and a file is wanted here{_what_directory(path)}"
        raise InputError(msg) from error
    except PermissionError as error:
        raise InputError(f"{path}: may not be read (permission denied). Change its permissions.") from error
    except UnicodeDecodeError as error:
        msg = f"{path}: is not a text file (byte {error.start} is not UTF-8). Check that it is the right file, and save a table as UTF-8."
        raise InputError(msg) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error


def read_text(path: Path) -> str:
    """The text of a UTF-8 file, without the mark that some editors put before it."""
    with reading(path):
        return path.read_text(encoding="utf-8-sig")


def finite(value: Any) -> Any:
    """What JSON can hold: numbers that are not finite become None, in mappings, lists and tuples too."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def parse_json(text: str, where: str, remedy: str) -> Any:
    """JSON text; `where` and `remedy` begin and end the sentence where it is none.

    Raises
    ------
    InputError
        Not JSON, or nested too deeply.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: is not JSON ({error}). {remedy}") from error


def parse_toml(text: str, where: str, refusal: type[GyrocalError] = InputError) -> dict[str, Any]:
    """TOML text; raises `refusal`, which names the line, where it is none or is nested too deeply."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise refusal(f"{where}: is not TOML: {error}. Correct that line.") from error
