"""One self-contained HTML page: verdict, figures with captions, tables, provenance. No network, no scripts."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Literal

import jinja2

#: Cells of more characters are set in several lines.
_LONGEST = 40
#: With or without its interval.
_NUMBER = re.compile(r"[-−+±<>~≈ ]*[\d.,e-]+( to [-−]?[\d.,e-]+)?( *%)?( \([-−+<\d.,e to]*\))?")


#: How a verdict is meant, told by word and colour: blue where nothing is judged.
Tone = Literal["plain", "good", "warning", "bad"]


@dataclass(frozen=True)
class Picture:
    """A figure of the page: its PNG, or the reason why the record carries none."""

    name: str
    title: str
    caption: str
    png: bytes | None = None
    missing: str = ""

    @property
    def source(self) -> str:
        """The picture itself, as a data address that needs no file beside the page."""
        return "data:image/png;base64," + base64.b64encode(self.png or b"").decode()


@dataclass(frozen=True)
class Table:
    """A table of ready-made cells; `csv` is what stands in the CSV file, with all digits."""

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    csv: str
    note: str = ""
    on_page: bool = True
    #: How a cell is meant, by what stands in it.
    tones: Mapping[str, Tone] = field(default_factory=dict)

    @property
    def classes(self) -> tuple[str, ...]:
        """How each column is set: ``long`` texts in lines, ``words`` to the left, numbers and ``interval`` to the right."""
        return tuple(_class([str(row[k]) for row in self.rows]) for k in range(len(self.columns)))


def _class(cells: Sequence[str]) -> str:
    if any(len(cell) > _LONGEST for cell in cells):
        return "long"
    numbers = [cell for cell in cells if _NUMBER.fullmatch(cell)]
    return ("interval" if any(" to " in cell for cell in numbers) else "") if numbers else "words"


@dataclass(frozen=True)
class Page:
    """What a report says, verdict first.

    Attributes
    ----------
    banner : what has to stand across the page (a simulation); empty: nothing
    lead : tables that stand above the figures
    quality : what the data lack or what could not be tested, folded at the end, never between findings
    """

    title: str
    verdict: str
    key_figures: Sequence[tuple[str, str]]
    remarks: Sequence[str]
    pictures: Sequence[Picture]
    tables: Sequence[Table]
    provenance: Mapping[str, str] = field(default_factory=dict)
    tone: Tone = "plain"
    banner: str = ""
    lead: Sequence[Table] = ()
    quality: Sequence[str] = ()
    beside: str = "Every table with all its digits, and every figure as PNG and SVG, stands beside this page."


def render_page(page: Page) -> str:
    """HTML text of a page; the same page gives the same text."""
    template = resources.files("gyrocal.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(template).render(page=page) + "\n"
