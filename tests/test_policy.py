"""What every command promises: help with an example, a place in the README, one error sentence and its exit code."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import gyrocal
from gyrocal.cli import COMMANDS, gyrocal_command, main
from gyrocal.errors import EXIT_CODES

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
#: Commands that are left for later sessions have no module yet.
READY = [name for name, (module, _) in COMMANDS.items() if (ROOT / f"gyrocal/cli/{module}.py").exists()]


def command_of(name: str) -> click.Command:
    """The click command `name`."""
    command = gyrocal_command.get_command(click.Context(gyrocal_command), name)
    assert command is not None
    return command


def examples(name: str) -> list[str]:
    """Example lines in a command's help."""
    text = re.sub(r"\s+", " ", command_of(name).help or "")
    return re.findall(r"Examples?: (gyrocal .*?)(?=$| (?:Examples?:|gyrocal ))", text)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_listed_command_exists(name: str) -> None:
    assert name in READY


@pytest.mark.parametrize("name", READY)
def test_help_says_every_option(name: str) -> None:
    result = CliRunner().invoke(gyrocal_command, [name, "--help"])
    assert result.exit_code == 0
    for parameter in command_of(name).params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"gyrocal {name}: {parameter.opts[0]} has no help"
            assert parameter.help.endswith((".", ")")), (
                f"gyrocal {name}: help of {parameter.opts[0]} has no full stop"
            )


@pytest.mark.parametrize("name", READY)
def test_help_holds_an_example_that_parses(name: str) -> None:
    found = examples(name)
    assert found, f"gyrocal {name} --help shows no line 'Example: gyrocal {name} ...'"
    for line in found:
        words = shlex.split(line)
        assert words[:2] == ["gyrocal", name]
        command = command_of(name)
        if isinstance(command, click.Group):
            sub = command.get_command(click.Context(command), words[2])
            assert sub is not None, f"{line}: no such subcommand"
            command, words = sub, words[1:]
        # Parsing checks options and arguments, and runs nothing.
        command.make_context(name, words[2:], resilient_parsing=False)


@pytest.mark.parametrize("name", READY)
def test_every_command_has_a_section_in_the_readme(name: str) -> None:
    assert f"gyrocal {name}" in README


@pytest.mark.parametrize("name", READY)
def test_json_is_offered_where_there_is_a_result(name: str) -> None:
    if name in ("decode", "export", "demo", "simulate", "probe"):
        pytest.skip("its result is the file, or lines that are meant for people")
    options = {o for p in command_of(name).params for o in p.opts}
    assert "--json" in options


def test_module_is_the_command() -> None:
    result = CliRunner().invoke(gyrocal_command, ["--version"])
    assert result.output.strip() == f"gyrocal, version {gyrocal.__version__}"


def test_an_error_is_one_sentence_and_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["fit", str(tmp_path / "nothing.csv"), "-o", str(tmp_path / "out.json")])
    assert ended.value.code == 3
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.strip().splitlines()
    assert line == f"gyrocal: {tmp_path / 'nothing.csv'}: no such file or directory. Check the path."
    assert list(tmp_path.iterdir()) == []


def test_exit_codes_are_in_the_readme() -> None:
    for cls, code in EXIT_CODES.items():
        assert re.search(rf"\| *{code} *\|", README), (
            f"README does not say what exit code {code} ({cls.__name__}) means"
        )
