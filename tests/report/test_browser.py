"""The page with wide tables: nothing runs over on a phone, nothing is cut off on paper, nothing is said on the console."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.report.style import new_figure, render
from tests.report.browser import look, needs_chromium, needs_pdftotext, printed_words

COLUMNS = [f"column{k}" for k in range(12)]
PAGE = Page(
    title="A page",
    verdict="It is as it should be, and the sentence that says so is as long as such sentences are.",
    key_figures=[("Angle random walk", "0.0812 deg/√h"), ("Bias instability", "1.93 deg/h")],
    remarks=["https://example.org/" + "a" * 200],
    pictures=[Picture("p", "A picture", "What it shows.", render(new_figure(7.0, 3.0), "png"))],
    tables=[Table("t", "Wide", COLUMNS, [["-123.456 to 789.012"] * 12] * 40, "")],
    lead=[Table("l", "First", ["figure", "before", "after"], [["bias", "1 deg/h", "0.1 deg/h"]], "")],
    quality=["run.json does not say profile"],
    tone="good",
    banner="SIMULATED",
)


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.html"
    path.write_text(render_page(PAGE), encoding="utf-8")
    return path


@needs_chromium
@pytest.mark.parametrize("width_px", [360, 1400])
def test_nothing_runs_over(page: Path, width_px: int, tmp_path: Path) -> None:
    seen = look(page, width_px, tmp_path)
    assert seen.wide_px <= seen.given_px
    assert seen.console == ""


@needs_chromium
@needs_pdftotext
def test_every_column_is_printed(page: Path, tmp_path: Path) -> None:
    words, outside = printed_words(page, tmp_path)
    assert outside == 0
    assert set(COLUMNS) <= set(words)
    # The head of a table stands again on each sheet that it runs over.
    assert words.count("column11") >= 2
    # Across the first sheet, letter by letter, and at the head of each.
    assert "SIMULATED" in "".join(words)
    assert words.count("SIMULATED") >= 2


def test_verdict_tables_pictures_and_limits_stand_in_that_order() -> None:
    text = render_page(PAGE)
    places = [
        text.index(word)
        for word in ('class="verdict good"', "First", "A picture", "Wide", "Limits of the data")
    ]
    assert places == sorted(places)


def test_a_page_without_them_has_no_banner_and_no_limits() -> None:
    text = render_page(replace(PAGE, banner="", quality=()))
    assert 'class="banner"' not in text
    assert "Limits of the data" not in text


def test_a_page_without_pictures_has_no_heading_for_them() -> None:
    text = render_page(replace(PAGE, pictures=[]))
    assert "<h2>Figures</h2>" not in text
    assert "<summary>1 note</summary>" in text
    assert "<summary>2 notes</summary>" in render_page(replace(PAGE, quality=["a", "b"]))


@needs_chromium
def test_many_short_columns_with_long_names_need_no_scrolling(tmp_path: Path) -> None:
    columns = ["Trial", *(f"no calibration, no filter {k}, cm" for k in range(9))]
    table = Table("t", "Wide", columns, [["1", *["332.6"] * 9]] * 3, "")
    path = tmp_path / "page.html"
    # A table that scrolls is made one that runs over.
    path.write_text(render_page(replace(PAGE, tables=[table])).replace("overflow-x: auto;", ""), "utf-8")
    seen = look(path, 1400, tmp_path)
    assert seen.wide_px <= seen.given_px
