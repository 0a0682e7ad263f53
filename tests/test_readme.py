"""Every command in the README and in the tutorials runs, in order, as it stands there."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from gyrocal.cli import COMMANDS, main

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared"
README = (ROOT / "README.md").read_text(encoding="utf-8")
TUTORIALS = sorted((ROOT / "sample_data" / "tutorials").glob("*.md"))
#: Marks in a comment above a block: run with the slow tests, needs ../shared, needs ports or a capture.
MARKS = ("slow", "shared", "ports")


@dataclass(frozen=True)
class Block:
    """Commands of one sh block, and the mark above it."""

    lines: tuple[str, ...]
    mark: str


def blocks(page: str) -> list[Block]:
    """The sh blocks of a page."""
    found = re.findall(r"(?:<!-- (\w+) -->\n)?```sh\n(.*?)```", page, flags=re.DOTALL)
    return [Block(tuple(text.strip().splitlines()), mark) for mark, text in found]


BLOCKS = blocks(README)
PARSED = [block for block in BLOCKS if block.lines[0].startswith("gyrocal")]
QUICK = [line for block in PARSED if not block.mark for line in block.lines]
LONG = [line for block in PARSED if block.mark == "slow" for line in block.lines]
REAL = [line for block in PARSED if block.mark == "shared" for line in block.lines]


def run(line: str) -> None:
    """Run a command line in this process; it must end well."""
    words = shlex.split(line)
    assert words[0] == "gyrocal"
    with pytest.raises(SystemExit) as ended:
        main(words[1:])
    assert ended.value.code == 0, line


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory with the sample data in it, and ../shared beside it where there is one."""
    place = tmp_path / "work"
    place.mkdir()
    (place / "sample_data").symlink_to(ROOT / "sample_data")
    if SHARED.exists():
        (tmp_path / "shared").symlink_to(SHARED)
    monkeypatch.chdir(place)
    return place


def test_marks_are_known() -> None:
    assert {block.mark for block in BLOCKS} <= {"", *MARKS}


def test_commands_and_options_exist() -> None:
    for block in PARSED:
        for line in block.lines:
            assert shlex.split(line)[1] in COMMANDS, line


@pytest.mark.parametrize("line", QUICK, ids=lambda line: line[:60])
def test_commands_run(line: str, workplace: Path) -> None:
    run(line)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("line", LONG, ids=lambda line: line[:60])
def test_long_commands_run(line: str, workplace: Path) -> None:
    run(line)


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.exists(), reason="../shared is absent")
def test_commands_on_the_real_table_run(workplace: Path) -> None:
    for line in REAL:
        run(line)


def python_of(page: str) -> dict[str, object]:
    """Names that the Python of a page defines when it is run."""
    names: dict[str, object] = {}
    for code in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        exec(compile(code, "page", "exec"), names)  # noqa: S102
    return names


def test_python_runs(workplace: Path) -> None:
    names = python_of(README)
    assert isinstance(names["rate_dps"], float)
    assert names["flag"] == 0


def test_there_are_tutorials_and_the_readme_links_them() -> None:
    assert TUTORIALS
    for page in TUTORIALS:
        assert f"(sample_data/tutorials/{page.name})" in README


#: Tutorials that take minutes.
LENGTHY = ("bench_to_robot", "simulation_and_reality")


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.slow] if p.stem in LENGTHY else []) for p in TUTORIALS],
)
def test_a_tutorial_runs_from_its_first_line_to_its_last(
    page: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = page.read_text(encoding="utf-8")
    for block in blocks(text):
        assert not block.mark
        for line in block.lines:
            run(line)
    monkeypatch.syspath_prepend(workplace)
    python_of(text)


@pytest.mark.parametrize("page", [ROOT / "README.md", *TUTORIALS], ids=lambda page: page.stem)
def test_links_and_pictures_exist(page: Path) -> None:
    linked = re.findall(r"\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    assert linked
    for link in linked:
        whole = (page.parent / link).read_bytes()
        assert whole.startswith(b"\x89PNG") == link.endswith(".png"), link


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_first_command_on_a_fresh_machine(tmp_path: Path) -> None:
    """A clone of what is committed, a fresh environment, the README's first command."""
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
    line = next(block.lines[0] for block in BLOCKS if "gyrocal demo" in block.lines[0])
    done = subprocess.run(
        ["bash", "-c", line.replace("python3", sys.executable)], cwd=clone, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert (clone / "demo/report/report.html").exists()
    assert "demo/report/report.html" in done.stdout
