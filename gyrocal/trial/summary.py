"""What a blind trial has shown: shares with 95 % Wilson intervals, confusion, coverage, gain, by strength."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrocal.physics.catalogue import CATALOGUE, law_of
from gyrocal.trial.blind import Trial
from gyrocal.units import NORMAL_95

#: Column and row of the confusion matrix for trials that hid, or named, no effect.
NOTHING = "nothing"


@dataclass(frozen=True)
class Share:
    """Hits of trials, with the 95 % Wilson score interval of their share (Wilson 1927)."""

    name: str
    hits: int
    trials: int

    @property
    def interval_95(self) -> tuple[float, float]:
        """Of the share; (0, 1) where there was no trial."""
        if self.trials == 0:
            return 0.0, 1.0
        z = NORMAL_95
        p, n = self.hits / self.trials, self.trials
        middle = p + z**2 / (2 * n)
        half = z * float(np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)))
        # Rounding must not carry the interval past the share itself at 0 and 1.
        low, high = (middle - half) / (1 + z**2 / n), (middle + half) / (1 + z**2 / n)
        return min(max(low, 0.0), p), max(min(high, 1.0), p)

    def to_json(self) -> dict[str, Any]:
        """Plain data; the share is null without trials."""
        share = self.hits / self.trials if self.trials else None
        return {
            "name": self.name,
            "hits": self.hits,
            "trials": self.trials,
            "share": share,
            "interval_95": list(self.interval_95),
        }

    def cells(self) -> tuple[str, str, str]:
        """Name, count and share for a table."""
        if self.trials == 0:
            return self.name, "0 of 0", "no trial"
        low, high = self.interval_95
        return (
            self.name,
            f"{self.hits} of {self.trials}",
            f"{self.hits / self.trials:.0%} ({low:.0%} to {high:.0%})",
        )


@dataclass(frozen=True)
class BlindSummary:
    """Figures of a blind trial.

    Attributes
    ----------
    by_strength : tuple of (d', shares)
        Single effects: right name first, in the reported class, right family.
    confusion : mapping
        Hidden effect to first name to count; single effects and nothing.
    gain_shares : tuple of float
        One a trial with single or several effects of known strength.
    """

    shares: tuple[Share, ...]
    by_strength: tuple[tuple[float, tuple[Share, ...]], ...]
    coverage: tuple[Share, ...]
    confusion: dict[str, dict[str, int]]
    gain_shares: tuple[float, ...]

    def to_json(self) -> dict[str, Any]:
        """For blind.json."""
        return {
            "shares": [s.to_json() for s in self.shares],
            "by_strength": [
                {"d_prime": d, "shares": [s.to_json() for s in shares]} for d, shares in self.by_strength
            ],
            "coverage": [s.to_json() for s in self.coverage],
            "confusion": self.confusion,
            "gain_share_median": float(np.median(self.gain_shares)) if self.gain_shares else None,
        }


def _named(trial: Trial) -> list[str]:
    return [law_of(e) for e in trial.named]


def _first(trial: Trial) -> bool:
    return bool(trial.named) and _named(trial)[0] == trial.truth[0]


def _in_class(trial: Trial) -> bool:
    return bool(trial.classes) and trial.truth[0] in map(law_of, trial.classes[0])


def _family(trial: Trial) -> bool:
    return bool(trial.named) and CATALOGUE[trial.named[0]].family == CATALOGUE[trial.truth[0]].family


def _exact(trial: Trial) -> bool:
    return Counter(_named(trial)) == Counter(trial.truth)


def _share(name: str, hits: Sequence[bool]) -> Share:
    return Share(name, sum(hits), len(hits))


def _single_shares(trials: Sequence[Trial]) -> tuple[Share, ...]:
    return (
        _share("right name first", [_first(t) for t in trials]),
        _share("in the reported class", [_in_class(t) for t in trials]),
        _share("right family", [_family(t) for t in trials]),
    )


def summarise(trials: Sequence[Trial]) -> BlindSummary:
    """Figures of opened trials."""
    nothing = [t for t in trials if not t.truth]
    single = [t for t in trials if len(t.truth) == 1]
    several = [t for t in trials if len(t.truth) > 1]
    strong = [t for t in single if t.secret.d_primes.get(t.truth[0], 0.0) >= 100.0]
    levels = sorted({t.secret.d_primes[t.truth[0]] for t in single if t.truth[0] in t.secret.d_primes})
    covered: dict[str, list[bool]] = {}
    for trial in trials:
        for name, inside in trial.covered.items():
            covered.setdefault(name, []).append(inside)
    everything = [inside for group in covered.values() for inside in group]
    shares = (
        _share("nothing hidden: something named", [bool(t.named) for t in nothing]),
        *(Share(f"one hidden: {s.name}", s.hits, s.trials) for s in _single_shares(single)),
        _share("one hidden, d' >= 100: no other name", [len(t.named) <= 1 for t in strong]),
        _share("several hidden: exact set", [_exact(t) for t in several]),
        _share("parameters: 95 % interval covers", everything),
    )
    return BlindSummary(
        shares,
        tuple(
            (d, _single_shares([t for t in single if t.secret.d_primes.get(t.truth[0]) == d])) for d in levels
        ),
        tuple(_share(name, group) for name, group in sorted(covered.items())),
        _confusion([*nothing, *single]),
        tuple(t.gain_share for t in trials if t.gain_share is not None),
    )


def _confusion(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    found: dict[str, Counter[str]] = {}
    for trial in trials:
        row = trial.truth[0] if trial.truth else NOTHING
        column = _named(trial)[0] if trial.named else NOTHING
        found.setdefault(row, Counter())[column] += 1
    return {row: dict(sorted(columns.items())) for row, columns in sorted(found.items())}
