"""Tables and sentences that fit the window: aligned, and folded where they would be too wide."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import zip_longest

#: Characters of a line where there is no window: a file, a job of CI.
_NO_WINDOW = 100
#: A number with its interval is so many words; a cell of more is a sentence.
_WORDS_OF_A_NUMBER = 4
#: What a line should not break within: an interval, a bound.
_WHOLE = re.compile(r"\(\S+ to \S+\)|\S+ \.\. \S+|< \S+")
_HARD_SPACE = "\N{NO-BREAK SPACE}"

Cells = Sequence[Sequence[str]]


def window_width() -> int:
    """Characters that a line may have: of the terminal that the user sits at, though the output may go to a pager."""
    with suppress(ValueError):
        return int(os.environ.get("COLUMNS", ""))
    for stream in (sys.__stdout__, sys.__stderr__, sys.__stdin__):
        with suppress(AttributeError, OSError, ValueError):
            return os.get_terminal_size(stream.fileno()).columns  # type: ignore[union-attr]
    return _NO_WINDOW


def plain_lines(columns: Sequence[str], rows: Cells) -> Iterator[str]:
    """Lines of a table; cells that are too wide fold."""
    flush = [i == 0 or is_prose(rows, i) for i in range(len(columns))]
    table = folded(columns, rows, window_width() - 2 * (len(columns) - 1))
    widths = [max(len(line) for cell in column for line in cell) for column in zip(*table, strict=True)]
    for row in table:
        for line in zip_longest(*row, fillvalue=""):
            cells = [
                c.ljust(w) if left else c.rjust(w) for c, w, left in zip(line, widths, flush, strict=True)
            ]
            yield "  ".join(cells).rstrip()


def is_prose(rows: Cells, index: int) -> bool:
    """Whether a column holds sentences, which begin at the left."""
    return any(len(row[index].split()) > _WORDS_OF_A_NUMBER for row in rows)


def folded(columns: Sequence[str], rows: Cells, width: int) -> list[list[list[str]]]:
    """Head and rows of a table, each cell as its lines, all columns together `width` wide if words allow it."""
    whole = [[_WHOLE.sub(_hold, cell) for cell in row] for row in (columns, *rows)]
    if sum(_least(whole)) > width:
        whole = [list(row) for row in (columns, *rows)]
    widths = _widths(whole, width)
    return [
        [
            [line.replace(_HARD_SPACE, " ") for line in textwrap.wrap(c, max(w, 1)) or [""]]
            for c, w in zip(row, widths, strict=True)
        ]
        for row in whole
    ]


def _hold(match: re.Match[str]) -> str:
    return match[0].replace(" ", _HARD_SPACE)


def _least(table: Cells) -> list[int]:
    """Longest word of each column."""
    # Not `split()`: that breaks at hard spaces.
    return [
        max(len(word) for cell in column for word in cell.split(" ")) for column in zip(*table, strict=True)
    ]


def _widths(table: Cells, width: int) -> list[int]:
    """Width of each column: the widest give way, down to their longest word, until the table fits."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    least = _least(table)
    while sum(widths) > width:
        k = max(range(len(widths)), key=lambda i: (widths[i] > least[i], widths[i]))
        if widths[k] <= least[k]:
            break
        widths[k] -= 1
    return widths
