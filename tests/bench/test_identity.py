"""Who measured what with which certificates: in the run's head, and refused where it is wrong."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path

import pytest
from click.testing import CliRunner

from gyrocal.bench.profile import load_profile, with_identity
from gyrocal.cli import gyrocal_command
from gyrocal.errors import ProfileError
from tests.bench.test_resume import toml
from tests.bench.tiny import tiny

BENCH = """[bench]
table = "Aerosmith 1270"
[identity]
table_certificate = "K-2211"
table_due = "2027-03-31"
"""


def test_the_run_says_who_measured(tmp_path: Path) -> None:
    bench, profile = tmp_path / "bench.toml", tmp_path / "tiny.toml"
    bench.write_text(BENCH)
    profile.write_text(toml(tiny()))
    words = ["acquire", str(profile), "--simulate", "--out", str(tmp_path / "run")]
    words += ["--serial", "F123", "--operator", "A. Kessler", "--bench-file", str(bench)]
    done = CliRunner().invoke(gyrocal_command, words)
    assert done.exit_code == 0, done.output
    head = json.loads((tmp_path / "run/run.json").read_text())
    assert head["identity"] == {
        "operator": "A. Kessler",
        "table_certificate": "K-2211",
        "table_due": "2027-03-31",
    }
    assert head["simulated"] is True
    assert head["sensor"]["serial"] == "virtual-F123"
    assert head["profile"]["identity"]["operator"] == "A. Kessler"


def test_a_bench_file_holds_nothing_else(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    bench.write_text("[plan]\nseed = 2\n")
    with pytest.raises(
        ProfileError, match=r"bench.toml: plan is an unknown key\. Known in the top level: bench, identity"
    ):
        with_identity(load_profile("quick"), None, None, bench)


def test_a_due_date_is_a_date(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    bench.write_text(BENCH.replace("2027-03-31", "31.3.2027"))
    with pytest.raises(
        ProfileError,
        match=r'bench.toml: identity.table_due is "31.3.2027", and allowed is a date as 2027-03-31',
    ):
        with_identity(load_profile("quick"), None, None, bench)


def test_a_certificate_that_has_expired_is_told_before_anything_moves(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    bench.write_text(BENCH.replace("2027-03-31", "2026-03-31"))
    words = ["acquire", "quick", "--dry-run", "--bench-file", str(bench)]
    said = CliRunner().invoke(gyrocal_command, words).output
    assert (
        "the table's certificate K-2211 expired on 2026-03-31: what is measured now is not traceable" in said
    )
    profile = with_identity(load_profile("quick"), None, None, bench)
    assert profile.notes(date(2026, 3, 31)) == ()
    assert len(profile.notes(date(2026, 4, 1))) == 1


def test_a_due_date_may_be_one_of_toml(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    bench.write_text(BENCH.replace('"2027-03-31"', "2027-03-31"))
    profile = with_identity(load_profile("quick"), None, None, bench)
    assert profile.identity.table_due == "2027-03-31"
    assert profile.source == "quick.toml"
    assert len(profile.sha256) == 64
