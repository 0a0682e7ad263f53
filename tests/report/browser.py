"""Pages as headless Chromium shows and prints them."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="Chromium is absent (Debian: apt install chromium)"
)
needs_pdftotext = pytest.mark.skipif(
    shutil.which("pdftotext") is None, reason="pdftotext is absent (Debian: apt install poppler-utils)"
)
_QUIET = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
]
#: Written into the title, so that it stands in the dumped document. A frame as wide as a phone: windows have a least width.
_MEASURE = """<script>addEventListener('load', () => {
  const d = document.getElementById('it').contentDocument.documentElement;
  document.title = 'wide=' + d.scrollWidth + ' of ' + d.clientWidth; });</script>"""


@dataclass(frozen=True)
class Seen:
    """What a browser made of a page, px; `console` holds what it said."""

    wide_px: int
    given_px: int
    console: str


def look(page: Path, width_px: int, workplace: Path) -> Seen:
    """Open `page` in a frame of that width."""
    text = page.read_text(encoding="utf-8").replace("&", "&amp;").replace('"', "&quot;")
    frame = workplace / f"frame{width_px}.html"
    frame.write_text(
        f'<html><head>{_MEASURE}</head><body><iframe id="it" width="{width_px}" height="800" srcdoc="{text}"></iframe>'
        "</body></html>",
        encoding="utf-8",
    )
    done = _run(workplace, "--window-size=1600,1000", "--enable-logging=stderr", "--dump-dom", frame.as_uri())
    found = re.search(r"wide=(\d+) of (\d+)", done.stdout)
    assert found, done.stdout[:300] + done.stderr[-600:]
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return Seen(int(found[1]), int(found[2]), "\n".join(said))


def printed_words(page: Path, workplace: Path) -> tuple[list[str], int]:
    """Words inside the sheets of the page's print-out, and how many words would lie outside."""
    pdf = workplace / "printed.pdf"
    _run(workplace, "--no-pdf-header-footer", f"--print-to-pdf={pdf}", page.as_uri())
    subprocess.run(["pdftotext", "-bbox", str(pdf), str(workplace / "words.html")], check=True)
    text = (workplace / "words.html").read_text(encoding="utf-8")
    width = max(float(w) for w in re.findall(r'<page width="([\d.]+)"', text))
    words, outside = [], 0
    for x_min, x_max, word in re.findall(
        r'<word xMin="(-?[\d.]+)"[^>]*? xMax="(-?[\d.]+)"[^>]*>([^<]*)<', text
    ):
        inside = float(x_min) >= 0 and float(x_max) <= width
        words += [word] if inside else []
        outside += not inside
    return words, outside


def _run(workplace: Path, *options: str) -> subprocess.CompletedProcess[str]:
    profile = workplace / "profile"
    return subprocess.run(
        [str(CHROMIUM), *_QUIET, f"--user-data-dir={profile}", *options],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
