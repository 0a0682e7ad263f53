"""Tables that fit the window: aligned, folded where they would be too wide, and set out row by row where that breaks numbers."""

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
_WHOLE = re.compile(r"\(\S+ to \S+\)|[-+]?\d\S* to [-+]?\d\S*|\S+ \.\. \S+|< \S+")
#: How far the further lines of a row's title stand in, and what belongs to a row that is set out.
_INDENT = "  "
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
    if table is None:
        yield from rows_set_out(columns, rows)
        return
    widths = [max(len(line) for cell in column for line in cell) for column in zip(*table, strict=True)]
    for row in table:
        for line in zip_longest(*row, fillvalue=""):
            cells = [
                c.ljust(w) if left else c.rjust(w) for c, w, left in zip(line, widths, flush, strict=True)
            ]
            yield "  ".join(cells).rstrip()


def rows_set_out(columns: Sequence[str], rows: Cells) -> Iterator[str]:
    """Each row as a paragraph: its title, and under it a line for each column that has something to say."""
    width = window_width()
    longest = max(map(len, columns[1:]), default=0)
    for title, *cells in rows:
        yield from textwrap.wrap(title, width, subsequent_indent=_INDENT)
        for name, cell in zip(columns[1:], cells, strict=True):
            if cell:
                begin = f"{_INDENT}{name.ljust(longest)}{_INDENT}"
                line = _WHOLE.sub(_hold, cell)
                hang = " " * min(len(begin), width // 2)
                lines = textwrap.wrap(line, width, initial_indent=begin, subsequent_indent=hang)
                yield from (part.replace(_HARD_SPACE, " ") for part in lines)


def is_prose(rows: Cells, index: int) -> bool:
    """Whether a column holds sentences, which begin at the left."""
    return any(len(row[index].split()) > _WORDS_OF_A_NUMBER for row in rows)


def folded(columns: Sequence[str], rows: Cells, width: int) -> list[list[list[str]]] | None:
    """Head and rows of a table, each cell as its lines, all columns together `width` wide; None where that breaks numbers."""
    whole = [[_WHOLE.sub(_hold, cell) for cell in row] for row in (columns, *rows)]
    if rows and sum(_least(whole)) > width:
        return None
    widths = _widths(whole, width)
    return [
        [
            [
                line.replace(_HARD_SPACE, " ")
                for line in textwrap.wrap(c, max(w, 1), subsequent_indent=hang) or [""]
            ]
            for c, w, hang in zip(row, widths, (_INDENT, *[""] * len(widths)), strict=False)
        ]
        for row in whole
    ]


def _hold(match: re.Match[str]) -> str:
    return match[0].replace(" ", _HARD_SPACE)


def _least(table: Cells) -> list[int]:
    """Longest word of each column; those of a title but the first stand in."""
    least = []
    for number, column in enumerate(zip(*table, strict=True)):
        # Not `split()`: that breaks at hard spaces.
        words = [cell.split(" ") for cell in column]
        hang = 0 if number else len(_INDENT)
        least.append(max(len(word) + (hang if k else 0) for cell in words for k, word in enumerate(cell)))
    return least


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
