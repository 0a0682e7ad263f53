"""The commented profile: it loads, holds every key, and every key in it is known."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from gyrocal.bench.profile import Profile, parse_profile
from gyrocal.bench.template import template
from gyrocal.cli import gyrocal_command
from gyrocal.errors import ProfileError


def test_it_loads_as_it_is() -> None:
    assert isinstance(parse_profile(template(), "template"), Profile)


def test_every_default_in_it_is_the_default() -> None:
    uncommented = re.sub(r"^# (\w+ = \S.*?    # .*)$", r"\1", template(), flags=re.MULTILINE)
    assert len(tomllib.loads(uncommented)["soak"]) == 6
    bare, full = parse_profile(template(), "template"), parse_profile(uncommented, "template")
    assert bare == full


def test_it_says_what_is_allowed() -> None:
    assert (
        '# temperature_order = "up_down"    # one of "up_down", "interleaved", "up", "down", "listed"'
        in template()
    )
    assert "# serial =    # a text; none by default" in template()


def test_the_command_writes_it(tmp_path: Path) -> None:
    target = tmp_path / "mine.toml"
    done = CliRunner().invoke(gyrocal_command, ["profile", "--template", "-o", str(target)])
    assert done.exit_code == 0
    assert "check it with: gyrocal acquire" in done.output
    assert target.read_text() == template()
    listed = CliRunner().invoke(gyrocal_command, ["profile"])
    assert "rd2100" in listed.output


def test_all_errors_are_listed_at_once() -> None:
    text = (
        template()
        .replace("sample_rate_hz = 10.0", "sample_rate_hz = -1")
        .replace('model = "KVH', 'modle = "KVH')
    )
    with pytest.raises(ProfileError) as caught:
        parse_profile(text, "p.toml")
    lines = str(caught.value).splitlines()
    assert lines == [
        "p.toml: sensor.modle is an unknown key. Did you mean model? Known in [sensor]: model, on_before_s, "
        "rate_range_dps, sample_rate_hz, serial, temp_range_c.",
        "p.toml: sensor.sample_rate_hz is -1, and allowed is a number from 0.1 to 10000 Hz.",
        "p.toml: sensor.model is missing; it wants a text.",
    ]


def test_all_contradictions_are_listed_at_once() -> None:
    text = (
        template().replace("[-40.0, 75.0]", "[75.0, -40.0]").replace("[20.0, 50.0, 100.0]", "[20.0, -50.0]")
    )
    with pytest.raises(ProfileError) as caught:
        parse_profile(text, "p.toml")
    assert [line.split(" is ")[0] for line in str(caught.value).splitlines()] == [
        "p.toml: sensor.temp_range_c",
        "p.toml: plan.rates_dps",
    ]
