"""Blind trial: physics hidden in virtual bench runs, answers sealed by a hash before the diagnosis, opened after.

It is a user's own proof on their own profile. It shares its formulas with the finder, so it proves less than
recordings made by other code do.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.bench.profile import Profile, VirtualTableSpec, load_profile
from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.laws.at_rows import untestable
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.diagnosis.rows.base import Base, fit_surface
from gyrocal.diagnosis.rows.columns import conditions_of, offer_of
from gyrocal.diagnosis.rows.series import Series, series_of_run
from gyrocal.errors import ProfileError
from gyrocal.inference.gram import project
from gyrocal.inference.whitening import NoiseLevels, NoiseModel, estimate_levels
from gyrocal.physics.catalogue import CATALOGUE, law_of
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect
from gyrocal.planning.next_experiment import to_toml
from gyrocal.records.run import Run, read_run
from gyrocal.trial.sealed import Sealed

Floats = NDArray[np.float64]
#: What diagnoses a run directory; a test puts another in its place.
Finder = Callable[[Path], Diagnosis]
#: Share done, 0 to 1, and what is being done.
Progress = Callable[[float, str], None]

#: Strengths that are drawn, d' after the surface is fitted: from what cannot be named to what cannot be missed.
_D_PRIMES = (6.0, 8.0, 12.0, 20.0, 40.0, 100.0)
#: The kind that hides single effects of the catalogue on the user's own profile; the others are made up whole.
SINGLE = "single"
#: How often nothing, one, two, or three effects are hidden.
_COUNTS = (0.2, 0.5, 0.2, 0.1)
_USUAL_ACCELERATION_DPS2 = VirtualTableSpec().max_acceleration_dps2


@dataclass(frozen=True)
class BlindConfig:
    """How many trials, with which seed, of which kind; single effects on which profile."""

    trials: int
    seed: int
    profile: str = "quick"
    false_alarm_rate: float = 0.01
    kind: str = SINGLE


@dataclass(frozen=True)
class Secret(Sealed):
    """What a trial hides: effect to parameters, and effect to d'; sealed with a nonce so that it cannot be guessed."""

    effects: Mapping[str, Mapping[str, float]]
    d_primes: Mapping[str, float]
    unit_seed: int
    noise_seed: int
    nonce: str


@dataclass(frozen=True)
class Trial:
    """A trial, opened.

    Attributes
    ----------
    commitment : str
        Written down before the run was diagnosed.
    covered : mapping
        ``effect.parameter`` to whether its 95 % interval holds the truth, for effects that were rightly named.
    gain_share : float or None
        Expected gain on a fresh run as a share of what an oracle gains that knows the effects' shapes.
    """

    number: int
    commitment: str
    secret: Secret
    verdict: str
    named: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    covered: Mapping[str, bool] = field(default_factory=dict)
    gain_share: float | None = None

    @property
    def truth(self) -> tuple[str, ...]:
        """Hidden effects, the strongest first."""
        d = self.secret.d_primes
        return tuple(sorted(self.secret.effects, key=lambda e: -d.get(e, 0.0)))

    def to_json(self) -> dict[str, Any]:
        """Plain data, the secret opened."""
        return {
            "trial": self.number,
            "commitment_sha256": self.commitment,
            "opened": json.loads(self.secret.text()),
            "verdict": self.verdict,
            "named": list(self.named),
            "classes": [list(c) for c in self.classes],
            "covered": dict(self.covered),
            "gain_share": self.gain_share,
        }


@dataclass(frozen=True)
class Rehearsal:
    """A clean run of the profile: what its record can carry, and how strongly each effect shows in it."""

    series: Series
    base: Base
    levels: NoiseLevels
    conditions: Conditions

    def d_prime(self, error_dps: Floats) -> float:
        """Signal-to-noise ratio of an error in the rows, the surface fitted."""
        columns = np.column_stack([error_dps, self.base.design])
        white = NoiseModel(self.series).whiten(self.levels, columns)[0]
        return float(np.sqrt(max(project(white.T @ white, np.arange(self.base.design.shape[1])).rss, 0.0)))

    def error_dps(self, effect: str, parameters: Mapping[str, float]) -> Floats:
        """An effect in the rows of the record."""
        shape = {k: v for k, v in parameters.items() if k != "amplitude"}
        unit = CATALOGUE[effect].unit_dps(self.conditions, shape, self.base.surface)
        return np.asarray(parameters["amplitude"] * unit)


def rehearse(run: Path, acceleration_dps2: float = _USUAL_ACCELERATION_DPS2) -> Rehearsal:
    """Reduce a run; what its table can do tells when it arrived at each rate."""
    opened = read_run(run)
    series = series_of_run(opened)
    base = fit_surface(series)
    levels = estimate_levels(NoiseModel(series), base.residual_dps, base.design).levels
    return Rehearsal(series, base, levels, _bench_conditions(opened, series, acceleration_dps2))


def _bench_conditions(run: Run, series: Series, acceleration_dps2: float) -> Conditions:
    """What the bench did in each row: it knows its commands, and when the table arrived, which the finder does not."""
    command = np.array([r.rate_dps for r in run.segments])
    arrived_s, last_s = np.empty(command.size), 0.0
    for k, record in enumerate(run.segments):
        if k and command[k] != command[k - 1]:
            step_s = abs(command[k] - command[k - 1]) / acceleration_dps2
            last_s = run.segments[k - 1].t_end_s + step_s
        arrived_s[k] = last_s if k else record.t_start_s
    of_row = series.set_index
    return replace(
        conditions_of(series), command_dps=command[of_row], since_step_s=series.t_s - arrived_s[of_row]
    )


def draw_secret(stage: Rehearsal, rng: np.random.Generator) -> Secret:
    """Draw what a trial hides: nothing, one effect or several, of random shape, sign and strength."""
    # Twins of one law cannot be hidden beside each other: nothing could tell them apart.
    known = [e for e in CATALOGUE if law_of(e) == e and e not in untestable(stage.series)]
    offer = offer_of(stage.series)
    count = int(rng.choice(len(_COUNTS), p=_COUNTS))
    effects: dict[str, dict[str, float]] = {}
    strengths: dict[str, float] = {}
    for effect in rng.choice(known, size=count, replace=False).tolist():
        hidden = CATALOGUE[effect]
        parameters = hidden.hiding.draw(hidden.typical(), offer, rng)
        if hidden.hiding.free_size:
            unit = stage.d_prime(stage.error_dps(effect, {**parameters, "amplitude": 1.0}))
            if unit <= 0:
                continue
            wanted = float(rng.choice(_D_PRIMES)) / unit
            sign = 1.0 if hidden.positive(parameters) else float(rng.choice([-1.0, 1.0]))
            bounds = hidden.parameter("amplitude")
            # What is hardly seen in this record would be larger than any gyro has it.
            parameters["amplitude"] = float(np.clip(sign * wanted, bounds.low, bounds.high))
            strengths[effect] = abs(parameters["amplitude"]) * unit
        effects[effect] = parameters
    seeds = rng.integers(1, 2**31, size=2)
    return Secret(effects, strengths, int(seeds[0]), int(seeds[1]), rng.bytes(16).hex())


def check_profile(config: BlindConfig) -> Profile:
    """The profile of the trials.

    Raises
    ------
    ProfileError
        No such profile, or one with physics hidden in it already.
    """
    profile = load_profile(config.profile)
    if profile.virtual.effects:
        raise ProfileError(
            f"{config.profile}: has virtual.effects already, and a blind trial draws its own. Remove them."
        )
    return profile


def run_trials(
    config: BlindConfig, commit: Callable[[int, str], None], progress: Progress, finder: Finder | None = None
) -> list[Trial]:
    """Hide, seal, diagnose, open and judge, trial after trial.

    Parameters
    ----------
    commit : callable
        Told each trial's number and commitment before its diagnosis begins.
    finder : callable, optional
        What diagnoses; `diagnose` unless given.

    Raises
    ------
    ProfileError
        No such profile, or one with physics hidden in it already.
    """
    profile = check_profile(config)
    options = Options(false_alarm_rate=config.false_alarm_rate, seed=config.seed)
    find = finder or (lambda run: diagnose(run, None, options))
    with tempfile.TemporaryDirectory(prefix="gyrocal-blind-") as place:
        progress(0.0, "rehearsal")
        clean = Secret({}, {}, config.seed + 1, config.seed + 1, "")
        acceleration = profile.virtual.table.max_acceleration_dps2
        stage = rehearse(_record(profile, clean, Path(place) / "rehearsal"), acceleration)
        trials = []
        for number in range(config.trials):
            progress(number / config.trials, f"trial {number + 1} of {config.trials}")
            rng = np.random.default_rng([config.seed, number])
            secret = draw_secret(stage, rng)
            commitment = secret.seal()
            commit(number, commitment)
            run = _record(profile, secret, Path(place) / f"trial{number:04d}")
            trials.append(judge(number, commitment, secret, find(run), run, acceleration))
    progress(1.0, "")
    return trials


class _Silent:
    """Nobody watches a trial's run."""

    def progress(self, progress: object) -> None:
        """Nothing is shown."""

    def say(self, text: str) -> None:
        """Nothing is said."""


def _record(profile: Profile, secret: Secret, out: Path) -> Path:
    """Acquire a run of the profile on the virtual bench with the secret's physics in it."""
    virtual = {
        **profile.raw.get("virtual", {}),
        "unit_seed": secret.unit_seed,
        "seed": secret.noise_seed,
        "effects": {effect: dict(p) for effect, p in secret.effects.items()},
    }
    source = out.with_suffix(".toml")
    source.write_text(to_toml({**profile.raw, "virtual": virtual}), encoding="utf-8")
    acquire(AcquireConfig(source, out, simulate=True), _Silent())
    _hide(out)
    return out


def _hide(run: Path) -> None:
    """Take the profile, which names the physics, out of the run's head: the finder must not be able to read it."""
    head = json.loads((run / "run.json").read_text(encoding="utf-8"))
    head.pop("profile", None)
    head.pop("profile_sha256", None)
    (run / "run.json").write_text(json.dumps(head), encoding="utf-8")


def judge(
    number: int,
    commitment: str,
    secret: Secret,
    found: Diagnosis,
    run: Path,
    acceleration_dps2: float = _USUAL_ACCELERATION_DPS2,
) -> Trial:
    """Open a trial: check its seal, and compare the answer with the truth."""
    secret.check(number, commitment)
    counted = [e for e in found.effects if e.effect in secret.effects or not always_there(e.effect)]
    return Trial(
        number,
        commitment,
        secret,
        found.verdict,
        tuple(e.effect for e in counted),
        tuple((e.effect, *(a.effect for a in e.alternatives)) for e in counted),
        _coverage(secret, found),
        _gain_share(secret, found, run, acceleration_dps2),
    )


def always_there(effect_id: str) -> bool:
    """Whether every recording has it, so that naming it is neither right nor wrong."""
    return CATALOGUE[effect_id].hiding.always_there


def _coverage(secret: Secret, found: Diagnosis) -> dict[str, bool]:
    covered = {}
    for effect in found.effects:
        truth = secret.effects.get(effect.effect, {})
        for name, estimate in effect.parameters.items():
            if name not in truth or not _comparable(CATALOGUE[effect.effect], name):
                continue
            low, high = estimate.interval_95
            if math.isnan(low):  # chosen from a few: nothing was stated
                continue
            values = [truth[name], -truth[name]] if "phase_rad" in truth else [truth[name]]
            covered[f"{effect.effect}.{name}"] = any(low <= v <= high for v in values)
    return covered


def _comparable(effect: Effect, name: str) -> bool:
    """Whether a parameter says the same to whoever hid it and to whoever found it."""
    return not effect.parameter(name).choice and (name != "amplitude" or effect.hiding.own_zero)


def _gain_share(secret: Secret, found: Diagnosis, run: Path, acceleration_dps2: float) -> float | None:
    """What the model removes of the hidden error, in units of what an oracle removes that only fits its sizes."""
    measured = [e for e in secret.effects if e in secret.d_primes]
    if not measured or found.rows is None:
        return None
    stage = rehearse(run, acceleration_dps2)
    if found.rows.t_s.size != len(stage.series):
        return None
    truth = np.sum([stage.error_dps(e, secret.effects[e]) for e in measured], axis=0)
    model = np.sum([*found.rows.effect_dps.values(), np.zeros(truth.size)], axis=0)
    whole, left = stage.d_prime(truth), stage.d_prime(model - truth)
    return float((1.0 - (left / whole) ** 2) / (1.0 - min(len(measured) / whole**2, 0.9)))
