"""What a blind trial on made-up recordings has shown: names by strength, wrong names, and what the corrections are worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrocal.trial.conceal import Layer
from gyrocal.trial.opened import Opened
from gyrocal.trial.summary import Share

#: Layers from here on are to be named.
NAMEABLE = 12.0
#: Bands of strength, d', in which layers are counted.
BANDS = ((0.0, 12.0), (12.0, 20.0), (20.0, 40.0), (40.0, 100.0), (100.0, float("inf")))


@dataclass(frozen=True)
class Tally:
    """Figures of opened trials of a kind.

    Attributes
    ----------
    by_strength : tuple of Share
        Layers that were given a right name, by band of d'.
    removed : tuple of float
        Share of the removable error on the second run that the improved file removes; one a recording where there
        is something to remove, the lowest first.
    """

    shares: tuple[Share, ...]
    by_strength: tuple[Share, ...]
    removed: tuple[float, ...]

    @property
    def removed_text(self) -> str:
        """Median, lowest tenth and lowest of what is removed, in words."""
        if not self.removed:
            return "nothing to remove"
        values = np.array(self.removed)
        return (
            f"median {np.median(values):.2f}, lowest tenth {np.percentile(values, 10):.2f}, "
            f"lowest {values.min():.2f}, of {values.size}"
        )

    def to_json(self) -> dict[str, Any]:
        """For blind.json."""
        return {
            "shares": [s.to_json() for s in self.shares],
            "by_strength": [s.to_json() for s in self.by_strength],
            "removed": list(self.removed),
            "removed_median": float(np.median(self.removed)) if self.removed else None,
            "removed_lowest_tenth": float(np.percentile(self.removed, 10)) if self.removed else None,
        }


def tally(trials: Sequence[Opened]) -> Tally:
    """Count opened trials."""
    hiding = [t for t in trials if t.answer.layers]
    clean = [t for t in trials if not t.answer.layers]
    judged = [t for t in trials if t.before_dps is not None]
    layers = [(t, a) for t in hiding for a in t.answer.layers]
    strong = [(t, a) for t, a in layers if a.d_prime >= NAMEABLE]
    names = [name in t.wrong for t in hiding for name in t.named]
    removed = sorted(t.share for t in trials if t.share is not None)

    def of_strong(name: str, hit: Callable[[Opened, Layer], bool]) -> Share:
        return _share(f"layers of d' {NAMEABLE:g} and more: {name}", [hit(t, a) for t, a in strong])

    shares = (
        of_strong("right name", Opened.has),
        of_strong("right name, or among the alternatives", Opened.has_in_class),
        of_strong("right family", Opened.has_family),
        _share("names given that are wrong", names),
        _share("recordings with a wrong name", [bool(t.wrong) for t in hiding]),
        _share("explained, with a wrong name or a layer missing", [_overstated(t) for t in hiding]),
        _share("nothing hidden: something named", [bool(t.named) for t in clean]),
        _share("second run worse than by the surface", [t.worse for t in judged]),
        _share("no surface for the second run", [t.before_dps is None for t in trials]),
    )
    by_strength = tuple(
        _share(_band(low, high), [t.has(a) for t, a in layers if low <= a.d_prime < high])
        for low, high in BANDS
    )
    return Tally(shares, by_strength, tuple(removed))


def _overstated(trial: Opened) -> bool:
    missing = any(a.d_prime >= NAMEABLE and not trial.has_in_class(a) for a in trial.answer.layers)
    return trial.verdict == "explained" and (bool(trial.wrong) or missing)


def _band(low: float, high: float) -> str:
    return f"d' {low:g} and more" if np.isinf(high) else f"d' {low:g} to {high:g}"


def _share(name: str, hits: Sequence[bool]) -> Share:
    return Share(name, sum(hits), len(hits))
