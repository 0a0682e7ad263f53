"""What every command shares: results on stdout, progress on stderr; rich on a terminal, plain lines when piped."""

from __future__ import annotations

import json
import math
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import click

from gyrocal.cli.plain import folded, is_prose, plain_lines, window_width

#: Say how far a piece of work is: share done, 0 to 1, and what is being done now.
Report = Callable[[float, str], None]

#: ``--json``, the same in every command.
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")

#: ``--overwrite``, the same in every command that writes one file.
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")


def finite_number(_ctx: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    """Refuse ``nan`` and ``inf``, which click takes for numbers in any range."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter("a finite number is wanted.")
    return value


def scale_number(_ctx: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    """Refuse what no scale of an output in counts can be: nothing, ``nan`` and ``inf``."""
    if value is not None and not (value and math.isfinite(value)):
        raise click.BadParameter("counts for each deg/s are wanted, sign included.")
    return value


#: What a terminal's table adds to each column.
_RULES = 3
#: Shares done at which a piped progress says a line.
_PLAIN_STEP = 0.25


def emit_json(data: Mapping[str, Any]) -> None:
    """Print `data` as one JSON document on stdout; NaN and infinity become null."""
    from gyrocal.records.files import finite

    click.echo(json.dumps(finite(data), indent=1, allow_nan=False))


def emit_table(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table of ready-made cells: ruled on a terminal, plain text when piped or too wide; cells fold."""
    ruled = folded(columns, rows, window_width() - _RULES * len(columns) - 1) if sys.stdout.isatty() else None
    if ruled is not None:
        from rich.console import Console
        from rich.table import Table

        table = Table(title=title or None, title_justify="left")
        for index, name in enumerate(columns):
            table.add_column(name, justify="left" if index == 0 or is_prose(rows, index) else "right")
        for row in ruled[1:]:
            table.add_row(*("\n".join(cell) for cell in row))
        Console(width=window_width()).print(table)
        return
    if title:
        click.echo(title)
    for line in plain_lines(columns, rows):
        click.echo(line)


def emit_list(sentences: Iterable[str]) -> None:
    """Print sentences, one a line; on a terminal they break between words."""
    for sentence in sentences:
        line = f"- {sentence}"
        if sys.stdout.isatty():
            line = textwrap.fill(line, window_width(), subsequent_indent="  ", break_on_hyphens=False)
        click.echo(line)


@contextmanager
def progress(title: str, *, quiet: bool = False, still: bool = False) -> Iterator[Report]:
    """Yield a `Report`: a bar with the time left on a terminal, a line a quarter when piped, nothing if `quiet`.

    A `still` bar is drawn at each report and not in between, so that it does not draw over what is asked and typed.
    """
    if quiet:
        yield lambda share, what: None
    elif sys.stderr.isatty():
        yield from _rich_bar(title, still=still)
    else:
        said = [-1]

        def report(share: float, what: str) -> None:
            step = int(share / _PLAIN_STEP)
            if step > said[0]:
                said[0] = step
                click.echo(f"{title}: {share:.0%}{', ' + what if what else ''}", err=True)

        yield report


def _rich_bar(title: str, *, still: bool) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[what]}"),
    )
    bar = Progress(*columns, console=Console(stderr=True), auto_refresh=not still)
    bar.start()
    try:
        task = bar.add_task(title, total=1.0, what="")

        def report(share: float, what: str) -> None:
            bar.update(task, completed=min(share, 1.0), what=what, refresh=still)

        yield report
    finally:
        with suppress(OSError):  # the terminal may be gone, and whoever reports knows it by now
            bar.stop()
