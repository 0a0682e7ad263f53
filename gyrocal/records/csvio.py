"""Strict numeric CSV: a header of known columns, numbers or empty cells below it."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.records.files import reading
from gyrocal.records.recognise import other_table, other_text

Floats = NDArray[np.float64]

_BLOCK_BYTES = 1 << 22
#: A line longer than this is none of a CSV.
_LONGEST_LINE = 1 << 24
#: No quantity is larger, nanoseconds since 1970 included; squares and cubes of it are still numbers.
_LARGEST = 1e20
_NUMBER = re.compile(
    r"\s*([+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?|nan)?\s*", re.IGNORECASE | re.ASCII
)
_QUOTED = re.compile(r'^"([^"]*)"$')
#: A quote within a cell, where one of a whole cell stands at its ends.
_INSIDE = re.compile(rb'"(?<=[^,\n]")(?=[^,\r\n])')
_BRACKETS = re.compile(r"[\[(].*")
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d")
#: Bytes that a row of numbers can hold; a look-up table is the fastest way to meet every byte of a long file.
_ALLOWED = np.zeros(256, dtype=np.bool_)
# Spreadsheets put cells into quotes.
_ALLOWED[list(b'0123456789+-.,eE \t\r\nnaifityNAIFTY"')] = True


def read_header(path: Path) -> list[str]:
    """Column names of the CSV file `path`.

    Raises
    ------
    InputError
        The file is missing, empty, binary, or still being written (``.part``).
    """
    if path.suffix == ".part":
        raise InputError(
            f"{path}: is still being written or was left by a crash (.part). Resume or redo its run."
        )
    with reading(path), path.open(encoding="utf-8-sig", newline="") as f:
        line = f.readline(_LONGEST_LINE)
    if "\0" in line or len(line) == _LONGEST_LINE:
        raise InputError(f"{path}: is not a text file. Check that it is the right file.")
    other = other_text(path, line)
    if other:
        raise InputError(f"{path}: {other}")
    # R quotes the names of columns and leaves its numbers bare.
    header = [_QUOTED.sub(r"\1", name.strip()) for name in line.strip().split(",")]
    if header == [""]:
        raise InputError(f"{path}: is empty. Check that it was written to its end.")
    if any(header) and all(_NUMBER.fullmatch(name) for name in header):
        msg = f"{path}, line 1: holds numbers where the names of the columns are wanted: the header is missing. Add it as the first line."
        raise InputError(msg)
    return header


def require_columns(
    path: Path, header: Sequence[str], required: Sequence[str], known: Sequence[str], remedy: str = ""
) -> None:
    """Refuse a header that lacks a required column, repeats one, or has one nobody knows.

    A column with a known quantity but another unit (``rate_rad_s`` for ``rate_dps``) falls under
    "nobody knows": its unit would otherwise be guessed. `remedy` ends the sentence where there is one beside renaming.
    """
    repeated = sorted(name for name, count in Counter(header).items() if count > 1)
    if repeated:
        raise InputError(f"{path}, line 1: column {repeated[0]:.80} stands twice. Remove one.")
    missing = [name for name in required if name not in header]
    unknown = [name for name in header if name not in known]
    other = other_table(header, required) if missing or unknown else ""
    if other:
        raise InputError(f"{path}: {other}")
    if missing:
        msg = (
            f"{path}, line 1: column {missing[0]} is missing (found: {', '.join(header)[:200]}). "
            f"{_hint(header, missing[0])}Names carry the unit; known: {', '.join(known)}.{remedy}"
        )
        raise InputError(msg)
    if unknown:
        msg = f"{path}, line 1: unknown column {unknown[0]!r:.80}. Names carry the unit; known: {', '.join(known)}.{remedy}"
        raise InputError(msg)


def _hint(header: Sequence[str], missing: str) -> str:
    """What is wrong with a header that lacks a column, as a sentence with a blank behind it; empty if it is not known."""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            return (
                f"The cells are separated by {name}: save the file with commas, and points in its numbers. "
            )
    if header[0].startswith("#"):
        return "The first line is a comment: remove it, so that the names come first. "
    near = [name for name in header if _BRACKETS.sub("", name).strip().lower() == missing]
    return f"Rename {near[0]!r:.80} to {missing}. " if near else ""


def iterate_columns(
    path: Path, header: Sequence[str], chunk_rows: int, only: Sequence[str] | None = None
) -> Iterator[tuple[int, dict[str, Floats]]]:
    """Yield ``(number of the first line, columns)`` for blocks of at most `chunk_rows` rows.

    Empty cells become NaN. Memory is bounded by the block. `only` reads those columns and leaves the
    others, which need not be numbers, alone (logs of other programs).

    Raises
    ------
    InputError
        A cell is not a number, or a row has too many or too few cells; the line is named.
    """
    wanted = list(header if only is None else only)
    _check_shape(path, header, wanted)
    first_line = 2
    try:
        with (
            reading(path),
            pd.read_csv(
                path,
                header=0,
                names=list(header),
                usecols=wanted,
                dtype=np.float64,
                encoding="utf-8-sig",
                skip_blank_lines=False,
                index_col=False,
                keep_default_na=False,
                na_values=["", "nan", "NaN"],
                chunksize=chunk_rows,
                engine="c",
            ) as blocks,
        ):
            for block in blocks:
                columns = {name: block[name].to_numpy() for name in wanted}
                _refuse_huge(path, first_line, columns)
                yield first_line, columns
                first_line += len(block)
    except (ValueError, pd.errors.ParserError) as error:
        _raise_at_bad_line(path, header, wanted, error)


def _refuse_huge(path: Path, first_line: int, columns: dict[str, Floats]) -> None:
    """Refuse finite numbers that no quantity has; infinite ones are the business of who knows the column."""
    for name, values in columns.items():
        size = np.abs(values)
        huge = np.flatnonzero((size > _LARGEST) & np.isfinite(size))
        if huge.size:
            msg = f"{path}, line {first_line + huge[0]}: {name:.80} is {values[huge[0]]:.6g}; no quantity is so large. Repair or remove the line."
            raise InputError(msg)


def read_columns(path: Path, header: Sequence[str]) -> dict[str, Floats]:
    """All columns of `path` as float arrays, shape (rows,); see `iterate_columns`."""
    blocks = [columns for _, columns in iterate_columns(path, header, 1 << 20)]
    if not blocks:
        return {name: np.empty(0) for name in header}
    if len(blocks) == 1:
        return blocks[0]
    return {name: np.concatenate([block[name] for block in blocks]) for name in header}


def _check_shape(path: Path, header: Sequence[str], wanted: Sequence[str]) -> None:
    """Refuse a row with another number of cells than the header, or a byte that no number has.

    The parser would fill short rows and cut long ones without a word.
    """
    tail = b""
    lines_before = 0
    with reading(path), path.open("rb") as f:
        while block := f.read(_BLOCK_BYTES):
            whole, newline, rest = block.rpartition(b"\n")
            if newline:
                lines_before = _check_lines(path, header, wanted, tail + whole + newline, lines_before)
                tail = rest
            else:
                tail += block
                if len(tail) > _LONGEST_LINE:
                    raise InputError(f"{path}: holds a line of more than {len(tail)} bytes; it is not a CSV.")
    if tail:
        _check_lines(path, header, wanted, tail + b"\n", lines_before)


def _check_lines(
    path: Path, header: Sequence[str], wanted: Sequence[str], text: bytes, lines_before: int
) -> int:
    raw = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero(raw == ord("\n"))
    commas = np.searchsorted(np.flatnonzero(raw == ord(",")), ends)
    body = 0 if lines_before else int(ends[0]) + 1
    every_column = len(wanted) == len(header)
    expected = (len(header) - 1) * np.arange(1, ends.size + 1)
    # Columns of other programs may hold quoted text, and commas in it.
    sound = np.array_equal(commas, expected) or (not every_column and b'"' in text)
    if not sound or (every_column and not _ALLOWED[raw[body:]].all()):
        _raise_at_bad_line(path, header, wanted, None)
    if every_column and (inside := _INSIDE.search(text, body)):
        line = lines_before + text.count(b"\n", 0, inside.start()) + 1
        raise InputError(f"{path}, line {line}: a quote stands within a number. Repair or remove the line.")
    return lines_before + int(ends.size)


def _raise_at_bad_line(
    path: Path, header: Sequence[str], wanted: Sequence[str], cause: Exception | None
) -> NoReturn:
    try:
        with reading(path), path.open(encoding="utf-8-sig", errors="replace", newline="") as f:
            for number, row in enumerate(csv.reader(f), start=1):
                if number == 1:
                    continue
                if not any(cell.strip() for cell in row) and len(row) < 2 <= len(header):
                    raise InputError(
                        f"{path}, line {number}: is empty. Remove it, and other empty lines."
                    ) from cause
                if len(row) != len(header):
                    why = (
                        "The file may be truncated; repair or remove the line"
                        if len(row) < len(header)
                        else "Its numbers may have decimal commas: write points, or repair the line"
                    )
                    msg = (
                        f"{path}, line {number}: {len(row)} cells where the header has {len(header)}. {why}."
                    )
                    raise InputError(msg) from cause
                for name, cell in zip(header, row, strict=True):
                    if name in wanted and _DATE.match(cell):
                        msg = f"{path}, line {number}: {name:.80} is {cell[:40]!r}, a date. Write seconds since any start that all rows share."
                        raise InputError(msg) from cause
                    if name in wanted and not _NUMBER.fullmatch(cell):
                        msg = f"{path}, line {number}: {name:.80} is {cell[:40]!r}, not a number. Repair or remove the line."
                        raise InputError(msg) from cause
    except csv.Error as error:  # a cell as long as a file
        cause = cause or error
    with reading(path), path.open("rb") as raw:
        start = raw.read(_BLOCK_BYTES)
    if b"\r" in start and b"\n" not in start:
        raise InputError(
            f"{path}: its lines end with carriage returns alone. Save it with the line ends of Unix or Windows."
        ) from cause
    raise InputError(f"{path}: cannot be parsed as CSV ({cause or 'unexpected bytes'}).") from cause


def format_columns(columns: dict[str, tuple[Floats, str]]) -> str:
    """CSV text of equally long columns, each with its format (``%.6f``); NaN becomes an empty cell."""
    text = io.StringIO()
    text.write(",".join(columns) + "\n")
    cells = [np.where(np.isnan(v), "", np.char.mod(fmt, v)) for v, fmt in columns.values()]
    for row in zip(*cells, strict=True):
        text.write(",".join(row) + "\n")
    return text.getvalue()
