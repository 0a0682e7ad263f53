"""The page holds everything it shows, says the verdict first, and trusts no text."""

from __future__ import annotations

import re
from html.parser import HTMLParser

from gyrocal.report.page import Page, Picture, Table, render_page

PAGE = Page(
    title="Calibration report: <gyro> & co",
    verdict="Error 100 -> 1 deg/h.",
    key_figures=[("Factor", "100")],
    remarks=["Scatter grows with |rate| < 3."],
    pictures=[
        Picture("figure_1", "Figure 1", "What to see.", b"\x89PNG-bytes"),
        Picture("timeline", "Course", "", missing="The recording has no times."),
    ],
    tables=[
        Table("coefficients", "Coefficients", ("Term", "Value"), [("c00", "+1.0")], "i,j\n"),
        Table("outliers", "Outliers", ("Data set",), [], "segment\n"),
        Table("data_sets", "Hidden", ("x",), [("HIDDEN",)], "x\n", on_page=False),
    ],
    provenance={"Recording": "run"},
)


class Collector(HTMLParser):
    """Every address that a browser would fetch, and whether tags close."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note addresses and open tags."""
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close the last open tag."""
        assert self.open.pop() == tag


def test_page_is_self_contained_and_well_formed() -> None:
    html = render_page(PAGE)
    collector = Collector()
    collector.feed(html)
    assert collector.open == []
    assert collector.addresses
    assert all(address.startswith("data:") for address in collector.addresses)
    assert "<script" not in html
    assert "@import" not in html
    assert "url(" not in html
    assert 'name="viewport"' in html
    assert "@media print" in html


def test_verdict_comes_first_and_nothing_is_lost() -> None:
    html = render_page(PAGE)
    order = [
        "Error 100 -&gt; 1 deg/h.",
        "Factor",
        "Scatter grows",
        "What to see.",
        "no times",
        "c00",
        "None.",
        "Recording",
    ]
    places = [html.index(text) for text in order]
    assert places == sorted(places)
    assert "HIDDEN" not in html


def test_text_is_escaped() -> None:
    html = render_page(PAGE)
    assert "<gyro>" not in html
    assert "Calibration report: &lt;gyro&gt; &amp; co" in html


def test_same_page_same_text() -> None:
    assert render_page(PAGE) == render_page(PAGE)
    assert not re.search(r"\b20\d\d-\d\d-\d\d", render_page(PAGE))


def test_columns_are_set_by_what_they_hold() -> None:
    rows = [
        (
            "bias",
            "-158.1 (-165.3 to -150.8)",
            "deg/h",
            "3 runs",
            "12 %",
            "the slope of the error over the rate of turn",
        ),
        ("maximum rate", "does not apply", "deg/s", "", "-", "-"),
    ]
    table = Table("t", "T", ("a", "b", "c", "d", "e", "f"), rows, "")
    assert table.classes == ("words", "interval", "words", "words", "", "long")
