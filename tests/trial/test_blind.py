"""The blind trial with finders whose skill is known: one that is told the answer, and one that always lies."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.commands.blind import write_blind
from gyrocal.diagnosis.result import Diagnosis, Estimate, NamedEffect, Verdict
from gyrocal.errors import ProfileError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.trial.blind import BlindConfig, Secret, draw_secret, judge, rehearse, run_trials
from gyrocal.trial.summary import Share, summarise
from tests.diagnosis.concealed_bench import make_recording, write_run

SMALL = """
title = "Small"
[sensor]
model = "RD2100"
sample_rate_hz = 10.0
rate_range_dps = [-100.0, 100.0]
temp_range_c = [-40.0, 75.0]
on_before_s = 60.0
[plan]
temperatures_c = [0.0, 30.0]
rates_dps = [20.0, 60.0, 100.0]
dwell_s = 5.0
[ramp]
rate_c_per_min = 4.0
[soak]
time_s = 120.0
slope_c_per_min = 50.0
slope_over_s = 60.0
"""


def _quiet(share: float, what: str) -> None:
    """No progress is shown."""


class _Watch:
    """Nobody watches."""

    def progress(self, progress: object) -> None:
        """Nothing is shown."""

    def say(self, text: str) -> None:
        """Nothing is said."""


def _answer(effects: dict[str, dict[str, float]], verdict: Verdict) -> Diagnosis:
    named = tuple(
        NamedEffect(
            effect,
            CATALOGUE[effect].family,
            {k: Estimate(v, 0.1, "", (v - 0.1, v + 0.1)) for k, v in parameters.items()},
            1e-9,
            (),
            None,
            CATALOGUE[effect].runtime,
        )
        for effect, parameters in effects.items()
    )
    return Diagnosis("run", verdict, (), named, {}, (), None, None, None, None, None)


@pytest.fixture(scope="module")
def profile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("profile") / "small.toml"
    path.write_text(SMALL)
    return path


def test_wilson_interval_of_the_literature() -> None:
    """Newcombe 1998, table I, method 3: 81 of 263 is 0.2553 to 0.3662, 0 of 20 is 0 to 0.1611."""
    assert Share("", 81, 263).interval_95 == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert Share("", 0, 20).interval_95 == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_seal_tells_answers_apart_and_cannot_be_guessed() -> None:
    secret = Secret({"shupe": {"amplitude": 1.0}}, {"shupe": 8.0}, 1, 2, "00")
    assert secret.seal() == replace(secret).seal()
    assert secret.seal() != replace(secret, nonce="01").seal()
    assert secret.seal() != replace(secret, effects={}).seal()


def test_opened_answer_must_be_the_sealed_one(tmp_path: Path) -> None:
    secret = Secret({}, {}, 1, 2, "00")
    with pytest.raises(ValueError, match="not what was sealed"):
        judge(0, "0" * 64, secret, _answer({}, "consistent"), tmp_path)


@pytest.mark.slow
def test_drawn_strength_is_the_strength_in_the_record(tmp_path: Path) -> None:
    write_run(make_recording([], 3, "even"), tmp_path / "run")
    stage = rehearse(tmp_path / "run")
    drawn = [draw_secret(stage, np.random.default_rng(k)) for k in range(12)]
    assert {len(s.effects) for s in drawn} >= {0, 1}
    for secret in drawn:
        for effect, d_prime in secret.d_primes.items():
            error = stage.error_dps(effect, secret.effects[effect])
            assert stage.d_prime(error) == pytest.approx(d_prime, rel=1e-6)


@pytest.mark.slow
def test_no_effect_is_drawn_larger_than_any_gyro_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(make_recording([], 3, "even"), tmp_path / "run")
    stage = rehearse(tmp_path / "run")
    monkeypatch.setattr("gyrocal.trial.blind._D_PRIMES", (1e9,))
    drawn = [draw_secret(stage, np.random.default_rng(k)) for k in range(12)]
    sizes = [
        (CATALOGUE[e].parameter("amplitude"), p["amplitude"]) for s in drawn for e, p in s.effects.items()
    ]
    assert len(sizes) > 3
    assert all(known.low <= size <= known.high for known, size in sizes)


QUIET_GYRO = """
[virtual.gyro]
lsb_deg = 0.0
angle_random_walk_deg_per_rt_h = 1e-6
bias_instability_deg_per_h = 1e-6
[virtual.effects]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("step_response", {"amplitude": 5.0, "tau_s": 3.0, "frequency_hz": 0.3, "phase_rad": 0.5}),
        ("reference_rate_error", {"amplitude": 50.0, "seed": 12345.0}),
        ("shupe_gradient", {"amplitude": 2.0, "tau_s": 300.0}),
    ],
)
def test_truth_in_the_rows_is_what_the_bench_did(
    effect: str, parameters: dict[str, float], tmp_path: Path
) -> None:
    """Against the difference of two noiseless virtual runs, one with the effect and one without."""
    text = "".join(f"{name} = {value}\n" for name, value in parameters.items())
    profiles = {
        "plain": SMALL + QUIET_GYRO,
        "with": SMALL + QUIET_GYRO + f"[virtual.effects.{effect}]\n" + text,
    }
    stages = {}
    for name, profile in profiles.items():
        source = tmp_path / f"{name}.toml"
        source.write_text(profile)
        acquire(AcquireConfig(source, tmp_path / name, simulate=True), _Watch())
        stages[name] = rehearse(tmp_path / name)
    a, b = stages["plain"].series, stages["with"].series
    _, i, j = np.intersect1d(np.round(a.t_s, 2), np.round(b.t_s, 2), return_indices=True)
    done = b.gyro_dps[j] - a.gyro_dps[i]
    stated = stages["plain"].error_dps(effect, parameters)[i]
    assert np.std(done - stated) < 0.06 * np.std(done)


@pytest.mark.slow
def test_trials_are_sealed_before_they_are_diagnosed(profile: Path) -> None:
    events: list[str] = []
    config = BlindConfig(2, 5, str(profile))

    def finder(run: Path) -> Diagnosis:
        events.append("diagnosed")
        assert "profile" not in json.loads((run / "run.json").read_text())
        return _answer({}, "consistent")

    trials = run_trials(config, lambda number, seal: events.append(seal), _quiet, finder)
    assert events == [trials[0].commitment, "diagnosed", trials[1].commitment, "diagnosed"]
    assert [t.secret.seal() for t in trials] == [t.commitment for t in trials]


def test_files_of_a_trial_and_a_lying_finder(profile: Path, tmp_path: Path) -> None:
    lie = _answer({"shupe": {"amplitude": 1.0}}, "explained")
    config = BlindConfig(1, 6, str(profile))
    result = write_blind(config, tmp_path / "a", _quiet, lambda run: lie)
    document = json.loads((tmp_path / "a" / "blind.json").read_text())
    seals = [line.split()[1] for line in (tmp_path / "a" / "commitments.txt").read_text().splitlines()]
    assert [t["commitment_sha256"] for t in document["trials"]] == seals
    nothing = next(s for s in result.summary.shares if s.name.startswith("nothing"))
    assert nothing.hits == nothing.trials == sum(not t.truth for t in result.trials)
    assert (tmp_path / "a" / "blind.html").read_text().count("data:image/png") == 2


def test_summary_of_a_finder_that_is_told_the_answer() -> None:
    secrets = [
        Secret({}, {}, 1, 1, ""),
        Secret({"shupe": {"amplitude": 2.0}}, {"shupe": 8.0}, 1, 1, ""),
        Secret({"shupe": {"amplitude": 2.0}, "warm_up": {"amplitude": 9.0, "tau_s": 500.0}}, {"shupe": 8.0, "warm_up": 12.0}, 1, 1, ""),
    ]  # fmt: skip
    trials = [
        judge(n, s.seal(), s, _answer({k: dict(v) for k, v in s.effects.items()}, "explained"), Path())
        for n, s in enumerate(secrets)
    ]
    shares = {s.name: (s.hits, s.trials) for s in summarise(trials).shares}
    assert shares["nothing hidden: something named"] == (0, 1)
    assert shares["one hidden: right name first"] == (1, 1)
    assert shares["several hidden: exact set"] == (1, 1)
    assert shares["parameters: 95 % interval covers"] == (4, 4)
    assert summarise(trials).confusion == {"nothing": {"nothing": 1}, "shupe": {"shupe": 1}}


def test_profile_that_hides_physics_already_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "spoilt.toml"
    path.write_text(SMALL + "[virtual.effects.shupe]\n")
    with pytest.raises(ProfileError, match=r"has virtual\.effects already"):
        run_trials(BlindConfig(1, 1, str(path)), lambda number, seal: None, _quiet)
