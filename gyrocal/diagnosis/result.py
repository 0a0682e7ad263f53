"""What `diagnose` finds: frozen records, and their JSON (``gyrocal-diagnosis/1`` of the formats)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion.coefficients import Coefficients

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SCHEMA = "gyrocal-diagnosis/1"
VERDICTS = ("consistent", "explained", "partly_explained", "unexplained")


@dataclass(frozen=True)
class Located:
    """Where the recording departs from the simulated sequence.

    Attributes
    ----------
    coordinate, statistic : str
        A coordinate of formats.md; ``mean`` or ``variance``.
    region : str
        Where on the coordinate, in words with units.
    share : float
        Part of the excess over noise that a curve on this coordinate takes up (parts may overlap).
    remains : bool
        Whether it is still there after the named effects are modelled.
    """

    coordinate: str
    statistic: str
    region: str
    p_value: float
    share: float
    remains: bool = False

    def to_json(self) -> dict[str, Any]:
        """Entry of ``located``."""
        return {
            "coordinate": self.coordinate,
            "statistic": self.statistic,
            "region": self.region,
            "p_value": _finite(self.p_value),
            "share": _finite(self.share),
            "remains": self.remains,
        }


@dataclass(frozen=True)
class Estimate:
    """A parameter of a named effect, with its standard deviation and 95 % interval."""

    value: float
    std: float
    unit: str
    interval_95: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """Entry of ``parameters``."""
        return {
            "value": _finite(self.value),
            "std": _finite(self.std),
            "unit": self.unit,
            "interval_95": [_finite(self.interval_95[0]), _finite(self.interval_95[1])],
        }


@dataclass(frozen=True)
class Alternative:
    """An effect that explains the data about as well as the named one."""

    effect: str
    #: Evidence of the named effect against this one (20 is strong; 1 cannot be told apart).
    evidence_ratio: float
    statement: str = ""

    def to_json(self) -> dict[str, Any]:
        """Entry of ``alternatives``."""
        return {"effect": self.effect, "evidence_ratio": _finite(self.evidence_ratio)}


@dataclass(frozen=True)
class Improvement:
    """Error on data that the fit did not see, before and after; deg/s.

    Attributes
    ----------
    interval_95 : tuple of float
        Of the drop in held-out rms, by a paired bootstrap of whole blocks.
    logloss_before, logloss_after : float
        Held-out log-loss, nats a data set, under the noise that is there.
    excess_removed : float
        Part of the held-out excess over the noise floor that the model removed.
    scheme : str
        What was left out together.
    """

    heldout_rms_before_dps: float
    heldout_rms_after_dps: float
    noise_floor_dps: float
    interval_95: tuple[float, float]
    logloss_before: float
    logloss_after: float
    logloss_interval_95: tuple[float, float]
    excess_removed: float
    scheme: str

    def to_json(self) -> dict[str, Any]:
        """Entry of ``improvement``."""
        return {
            "heldout_rms_before_dps": _finite(self.heldout_rms_before_dps),
            "heldout_rms_after_dps": _finite(self.heldout_rms_after_dps),
            "noise_floor_dps": _finite(self.noise_floor_dps),
            "interval_95": [_finite(x) for x in self.interval_95],
            "logloss_before_nats": _finite(self.logloss_before),
            "logloss_after_nats": _finite(self.logloss_after),
            "logloss_interval_95": [_finite(x) for x in self.logloss_interval_95],
            "excess_removed": _finite(self.excess_removed),
            "left_out": self.scheme,
        }


@dataclass(frozen=True)
class NamedEffect:
    """Physics that the model lacked, named."""

    effect: str
    family: str
    statement: str
    parameters: Mapping[str, Estimate]
    p_value: float
    alternatives: tuple[Alternative, ...]
    improvement: Improvement | None
    runtime: bool

    def to_json(self) -> dict[str, Any]:
        """Entry of ``effects``."""
        return {
            "effect": self.effect,
            "family": self.family,
            "statement": self.statement,
            "parameters": {k: e.to_json() for k, e in self.parameters.items()},
            "p_value": _finite(self.p_value),
            "alternatives": [a.to_json() for a in self.alternatives],
            "improvement": None if self.improvement is None else self.improvement.to_json(),
            "runtime": self.runtime,
        }


@dataclass(frozen=True)
class Rows:
    """The recording row by row, for pictures; arrays of shape (n,), NaN where a channel was not logged.

    ``before`` is recording minus simulated sequence (surface alone), ``after`` minus the model with the named
    physics; ``effect_dps[id]`` is what each named effect adds. ``white_std_dps`` is the white noise of a row.
    """

    t_s: Floats
    rate_dps: Floats
    temp_c: Floats
    temp_rate_c_per_min: Floats
    set_index: Ints
    is_set: NDArray[np.bool_]
    before_dps: Floats
    after_dps: Floats
    white_std_dps: Floats
    angle_deg: Floats
    supply_v: Floats
    since_power_on_s: Floats
    since_set_s: Floats
    step_dps: Floats
    effect_dps: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class NoiseFigures:
    """Levels of the noise under the final model; None: this record does not tell."""

    white_std_dps: float
    angle_random_walk_deg_per_rt_h: float | None
    bias_instability_deg_per_h: float
    rate_jitter_ppm: float
    rate_random_walk_deg_per_h_per_rt_h: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Entry ``noise``."""
        return {
            "white_std_dps": _finite(self.white_std_dps),
            "angle_random_walk_deg_per_rt_h": _finite(self.angle_random_walk_deg_per_rt_h),
            "bias_instability_deg_per_h": _finite(self.bias_instability_deg_per_h),
            "rate_random_walk_deg_per_h_per_rt_h": _finite(self.rate_random_walk_deg_per_h_per_rt_h),
            "rate_jitter_ppm": _finite(self.rate_jitter_ppm),
        }


@dataclass(frozen=True)
class Diagnosis:
    """The answer: verdict, places, names, numbers.

    Attributes
    ----------
    verdict : str
        One of `VERDICTS`.
    sentences : tuple of str
        What there is to say, plainly, in order.
    surface : Coefficients
        The model before: the coefficients given, or fitted here.
    improved : Coefficients or None
        Surface refitted together with the named physics, which is in its ``terms``.
    rows : Rows or None
        What pictures need; not part of the JSON.
    next_experiment : mapping or None
        Filled by `gyrocal.diagnosis.next_experiment`.
    counted_in : str
        What log-losses are counted in where the rows do not tell, as of a drive; not part of the JSON.
    """

    recording: str
    verdict: str
    located: tuple[Located, ...]
    effects: tuple[NamedEffect, ...]
    not_testable: Mapping[str, str]
    sentences: tuple[str, ...]
    noise: NoiseFigures | None
    improvement: Improvement | None
    surface: Coefficients | None
    improved: Coefficients | None
    rows: Rows | None
    notes: tuple[str, ...] = ()
    next_experiment: Mapping[str, Any] | None = None
    counted_in: str = ""

    def to_json(self) -> dict[str, Any]:
        """The document that `diagnose` writes; plain, finite JSON values."""
        return {
            "schema": SCHEMA,
            "recording": self.recording,
            "verdict": self.verdict,
            "located": [place.to_json() for place in self.located],
            "effects": [effect.to_json() for effect in self.effects],
            "improvement": None if self.improvement is None else self.improvement.to_json(),
            "not_testable": dict(self.not_testable),
            "noise": None if self.noise is None else self.noise.to_json(),
            "statements": list(self.sentences),
            "notes": list(self.notes),
            "next_experiment": None if self.next_experiment is None else dict(self.next_experiment),
        }


def _finite(value: float | None) -> float | None:
    """A number for JSON: null where it is not known or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)
