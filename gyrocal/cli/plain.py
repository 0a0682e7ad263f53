"""Tables as plain text: aligned, and folded where they would be too wide."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from itertools import zip_longest

#: Characters that a table may be wide.
_PLAIN_WIDTH = 100
#: A number with its interval is so many words; a cell of more is a sentence.
_WORDS_OF_A_NUMBER = 4


def plain_lines(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines of a table; cells that are too wide fold."""
    widths = _widths(columns, rows)
    flush = [i == 0 or is_prose(rows, i) for i in range(len(columns))]
    for row in (columns, *rows):
        folded = [textwrap.wrap(c, w) if len(c) > w else [c] for c, w in zip(row, widths, strict=True)]
        for line in zip_longest(*folded, fillvalue=""):
            cells = [
                c.ljust(w) if left else c.rjust(w) for c, w, left in zip(line, widths, flush, strict=True)
            ]
            yield "  ".join(cells).rstrip()


def is_prose(rows: Sequence[Sequence[str]], index: int) -> bool:
    """Whether a column holds sentences, which begin at the left."""
    return any(len(row[index].split()) > _WORDS_OF_A_NUMBER for row in rows)


def _widths(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[int]:
    """Width of each column: the widest give way, down to their longest word, until the table fits `_PLAIN_WIDTH`."""
    cells = list(zip(columns, *rows, strict=True))
    widths = [max(map(len, column)) for column in cells]
    least = [max(len(word) for cell in column for word in cell.split() or [""]) for column in cells]
    while sum(widths) + 2 * (len(widths) - 1) > _PLAIN_WIDTH:
        k = max(range(len(widths)), key=lambda i: (widths[i] > least[i], widths[i]))
        if widths[k] <= least[k]:
            break
        widths[k] -= 1
    return widths
