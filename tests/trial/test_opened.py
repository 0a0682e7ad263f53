"""The blind trial on made-up recordings, with finders whose skill is known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from gyrocal.cli import gyrocal_command
from gyrocal.commands.blind import write_made_up
from gyrocal.diagnosis.result import Diagnosis, NamedEffect, Verdict
from gyrocal.errors import DataError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.trial.blind import BlindConfig
from gyrocal.trial.conceal import Concealed, Layer
from gyrocal.trial.made_up import make_up
from gyrocal.trial.opened import REFUSED, Opened, judge_made_up, run_made_up
from gyrocal.trial.tally import tally


def _quiet(share: float, what: str) -> None:
    """No progress is shown."""


def _answer(names: list[str], verdict: Verdict = "explained") -> Diagnosis:
    named = tuple(
        NamedEffect(e, CATALOGUE[e].family, {}, 1e-9, (), None, CATALOGUE[e].runtime) for e in names
    )
    return Diagnosis("run", verdict, (), named, {}, (), None, None, None, None, None)


def _layer(name: str, d_prime: float) -> Layer:
    return Layer(name, (name,), CATALOGUE[name].family, True, {}, 1.0, d_prime, d_prime, 1.0)


def _opened(
    layers: list[Layer], named: list[str], verdict: str, errors: tuple[float, float, float]
) -> Opened:
    before, after, oracle = errors
    answer = Concealed("layers", "fog", "sweep", "none", (), tuple(layers), "00")
    share = (before - after) / (before - oracle) if layers else None
    classes = tuple((n,) for n in named)
    return Opened(0, "", answer, verdict, tuple(named), classes, before, after, oracle, oracle, share)


def test_sealed_before_it_is_diagnosed_and_the_second_run_shown_after(tmp_path: Path) -> None:
    events: list[str] = []

    def finder(recording: Path) -> Diagnosis:
        events.append("diagnosed")
        assert recording.exists()
        assert not any(p.name.startswith("second") for p in recording.parent.iterdir())
        return _answer([])

    config = BlindConfig(1, 1, kind="layers")
    (trial,) = run_made_up(config, tmp_path, lambda number, seal: events.append(seal), _quiet, finder)
    assert events == [trial.answer.seal(), "diagnosed"]
    assert (tmp_path / "0000" / "second.csv").exists()
    assert trial.oracle_dps is not None
    assert trial.share is None


def test_another_answer_than_the_sealed_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not what was sealed"):
        judge_made_up(0, "0" * 64, make_up("layers", 1, 0), _answer([]), tmp_path)


def test_what_cannot_be_diagnosed_is_counted(tmp_path: Path) -> None:
    def finder(recording: Path) -> Diagnosis:
        raise DataError(f"{recording}: too little. Record more.")

    (trial,) = run_made_up(BlindConfig(1, 1, kind="layers"), tmp_path, lambda n, s: None, _quiet, finder)
    assert trial.verdict == REFUSED
    assert trial.refusal == "./recording.csv: too little. Record more."


def test_figures_of_trials_whose_outcome_is_known() -> None:
    trials = [
        _opened([_layer("shupe", 20.0), _layer("warm_up", 8.0)], ["shupe"], "explained", (10.0, 1.0, 1.0)),
        _opened([_layer("shupe", 50.0)], ["thermal_lag"], "explained", (10.0, 19.0, 1.0)),
        _opened([_layer("bias_step", 300.0)], [], "unexplained", (10.0, 5.5, 1.0)),
        _opened([], ["shupe"], "explained", (1.0, 1.0, 1.0)),
    ]
    counted = tally(trials)
    assert [(s.hits, s.trials) for s in counted.shares] == [
        (1, 3),  # right name
        (1, 3),  # or among the alternatives
        (2, 3),  # right family
        (1, 2),  # names that are wrong
        (1, 3),  # recordings with a wrong name
        (1, 3),  # explained and should not be
        (1, 1),  # nothing hidden, something named
        (1, 4),  # worse
        (0, 4),  # no surface
    ]
    assert [(s.hits, s.trials) for s in counted.by_strength] == [(0, 1), (0, 0), (1, 1), (0, 1), (0, 1)]
    assert counted.removed == (-1.0, 0.5, 1.0)
    assert counted.removed_text == "median 0.50, lowest tenth -0.70, lowest -1.00, of 3"
    assert trials[1].wrong == ("thermal_lag",)


def test_files_of_a_trial(tmp_path: Path) -> None:
    for out in ("a", "b"):
        config = BlindConfig(1, 1, kind="layers")
        write_made_up(config, tmp_path / out, _quiet, lambda recording: _answer(["shupe"]))
    text = (tmp_path / "a" / "blind.json").read_text()
    document = json.loads(text)
    assert text == (tmp_path / "b" / "blind.json").read_text()
    assert document["kind"] == "layers"
    seals = [line.split()[1] for line in (tmp_path / "a" / "commitments.txt").read_text().splitlines()]
    assert [t["commitment"] for t in document["trials"]] == seals
    assert document["trials"][0]["wrong"] == ["shupe"]
    assert "shupe" in (tmp_path / "a" / "blind.html").read_text()


def test_a_profile_is_for_single_effects(tmp_path: Path) -> None:
    arguments = ["blind", "--kind", "nulls", "--profile", "quick", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(gyrocal_command, arguments)
    assert result.exit_code == 2
    assert "--profile is for --kind single" in result.output


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_small_trial_from_end_to_end(tmp_path: Path) -> None:
    result = write_made_up(BlindConfig(2, 1, kind="layers"), tmp_path / "out", _quiet)
    assert all(t.before_dps and t.after_dps and t.oracle_dps for t in result.trials)
    assert all(t.share is not None for t in result.trials)
    assert result.tally.shares[0].hits > 0
