"""The blind trial on made-up recordings: sealed, diagnosed, opened, and judged on a second run of the same gyro."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.errors import GyrocalError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.records.files import write_atomically
from gyrocal.trial.blind import BlindConfig, Finder, Progress, always_there
from gyrocal.trial.conceal import Concealed, Layer
from gyrocal.trial.made_up import MadeUp, make_up
from gyrocal.trial.second import WORTH, consult_oracle, corrected_rms_dps, share_removed

#: Verdict on a recording that was not diagnosed.
REFUSED = "refused"
#: Worse than the surface by more than this is worse, where the record allows better.
_WORSE = 1.05


@dataclass(frozen=True)
class Opened:
    """A trial, opened.

    Attributes
    ----------
    named : tuple of str
        Names given, the strongest first.
    classes : tuple of tuple of str
        Each name with its alternatives.
    before_dps, after_dps, oracle_dps : float or None
        Error on the second run: of the surface, of the improved file (the surface's where there is none), and of
        a fit that knows the laws and the noise. Infinite, null in JSON, where a row cannot be corrected.
    allowed_dps : float or None
        What that fit had to expect, or what it left if that is more.
    share : float or None
        Of the removable error, what the improved file removes; None where there is none to remove.
    """

    number: int
    commitment: str
    answer: Concealed
    verdict: str
    named: tuple[str, ...] = ()
    classes: tuple[tuple[str, ...], ...] = ()
    before_dps: float | None = None
    after_dps: float | None = None
    oracle_dps: float | None = None
    allowed_dps: float | None = None
    share: float | None = None
    refusal: str = ""

    def has(self, layer: Layer) -> bool:
        """Whether a right name was given to a layer."""
        return bool(set(layer.right) & set(self.named))

    def has_in_class(self, layer: Layer) -> bool:
        """Whether a right name was given, or stands among the alternatives."""
        return any(set(layer.right) & set(c) for c in self.classes)

    def has_family(self, layer: Layer) -> bool:
        """Whether an effect of the layer's family was named."""
        return layer.family in {CATALOGUE[e].family for e in self.named}

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names given that no layer has."""
        right = {name for layer in self.answer.layers for name in layer.right}
        return tuple(e for e in self.named if e not in right)

    @property
    def worse(self) -> bool:
        """Whether the improved file is worse than the surface on the second run, beyond what noise explains."""
        if self.before_dps is None or self.after_dps is None or self.allowed_dps is None:
            return False
        return self.after_dps > max(_WORSE * self.before_dps, WORTH * self.allowed_dps)

    def to_json(self) -> dict[str, Any]:
        """Plain data, the answer opened."""
        plain = {k: None if v == float("inf") else v for k, v in asdict(self).items() if k != "answer"}
        return {**plain, "opened": json.loads(self.answer.text()), "wrong": list(self.wrong)}


def run_made_up(
    config: BlindConfig,
    out: Path,
    commit: Callable[[int, str], None],
    progress: Progress,
    finder: Finder | None = None,
) -> list[Opened]:
    """Make up, seal, diagnose, open and judge, recording after recording; they stay in `out`.

    Parameters
    ----------
    commit : callable
        Told each trial's number and commitment before its diagnosis begins.
    finder : callable, optional
        What diagnoses; `diagnose` unless given.
    """
    options = Options(false_alarm_rate=config.false_alarm_rate, seed=config.seed)
    find = finder or (lambda recording: diagnose(recording, None, options))
    opened = []
    for number in range(config.trials):
        progress(number / config.trials, f"trial {number + 1} of {config.trials}")
        made = make_up(config.kind, config.seed, number)
        commitment = made.answer.seal()
        commit(number, commitment)
        opened.append(_one(number, commitment, made, out / f"{number:04d}", find))
    progress(1.0, "")
    return opened


def _one(number: int, commitment: str, made: MadeUp, out: Path, find: Finder) -> Opened:
    out.mkdir(parents=True)
    recording = made.write(out)
    try:
        found = find(recording)
    except GyrocalError as error:
        return Opened(number, commitment, made.answer, REFUSED, refusal=str(error).replace(str(out), "."))
    return judge_made_up(number, commitment, made, found, out)


def judge_made_up(number: int, commitment: str, made: MadeUp, found: Diagnosis, out: Path) -> Opened:
    """Open a trial: check its seal, compare names, and try the correction on the second run, which goes to `out`."""
    made.answer.check(number, commitment)
    right = {name for layer in made.answer.layers for name in layer.right}
    neutral = set(made.answer.also) - right
    counted = [
        e for e in found.effects if e.effect in right or not (e.effect in neutral or always_there(e.effect))
    ]
    second = made.write_second(out)
    for name, model in (("surface", found.surface), ("improved", found.improved)):
        if model is not None:
            write_atomically(out / f"{name}.json", model.to_text())
    before = corrected_rms_dps(second, made.second, found.surface)
    after = corrected_rms_dps(second, made.second, found.improved or found.surface)
    oracle = consult_oracle(made.bench, made.gyro_dps, made.second, made.gyro, made.hidden)
    return Opened(
        number,
        commitment,
        made.answer,
        found.verdict,
        tuple(e.effect for e in counted),
        tuple((e.effect, *(a.effect for a in e.alternatives)) for e in counted),
        before,
        after,
        oracle.rms_dps,
        oracle.allowed_dps,
        share_removed(before, after, oracle),
    )
