"""What `diagnose` finds: frozen records, and their JSON (``gyrocal-diagnosis/1`` of the formats)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.remarks import Note, Remark
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.lacking import Reason
from gyrocal.records.files import finite
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SCHEMA = "gyrocal-diagnosis/1"
#: An amplitude this near to a bound of the catalogue, as a share of it, ends there: a search stops short by less.
_AT_BOUND = 1e-3
Verdict = Literal["consistent", "explained", "partly_explained", "unexplained"]


@dataclass(frozen=True)
class Located:
    """Where the recording departs from the simulated sequence.

    Attributes
    ----------
    coordinate, statistic : str
        A coordinate of formats.md; ``mean`` or ``variance``.
    share : float
        Part of the excess over noise that a curve on this coordinate takes up (parts may overlap).
    remains : bool
        Whether the named effects do not explain it.
    curve : bool
        Of what they do not: whether a curve without a name, which is in the model, follows it.
    low, high : float, optional
        The stretch of the coordinate where it is, in `unit`; None: all along.
    target : str
        What departs, or what it follows there: ``bias``, ``scale factor``, ``surface``, ``samples``, the name of
        a generic curve; empty: nobody can say.
    rms_dps : float, optional
        Size of the departure over the whole record, deg/s.
    times_given : float, optional
        Noise there over what was given for it.
    finding : str
        Effect that was found there by a test of its own, and says the rest.
    """

    coordinate: str
    statistic: str
    p_value: float
    share: float
    remains: bool = False
    curve: bool = False
    low: float | None = None
    high: float | None = None
    unit: str = ""
    target: str = ""
    rms_dps: float | None = None
    times_given: float | None = None
    finding: str = ""

    def to_json(self) -> dict[str, Any]:
        """Entry of ``located``."""
        return {
            "coordinate": self.coordinate,
            "statistic": self.statistic,
            "from": finite(self.low),
            "to": finite(self.high),
            "unit": self.unit,
            "target": self.target,
            "rms_dps": finite(self.rms_dps),
            "times_given": finite(self.times_given),
            "p_value": finite(self.p_value),
            "share": finite(self.share),
            "remains": self.remains,
            "curve": self.curve,
        }


@dataclass(frozen=True)
class Estimate:
    """A parameter of a named effect, with its standard deviation and 95 % interval."""

    value: float
    std: float
    unit: str
    interval_95: tuple[float, float]

    @classmethod
    def normal(cls, value: float, std: float, unit: str) -> Self:
        """A normal estimate."""
        return cls(value, std, unit, (value - NORMAL_95 * std, value + NORMAL_95 * std))

    @classmethod
    def spanning(cls, value: float, interval: tuple[float, float], unit: str) -> Self:
        """An estimate by its interval, with the standard deviation of a normal one as wide."""
        return cls(value, (interval[1] - interval[0]) / (2.0 * NORMAL_95), unit, interval)

    def open_at(self, low: float, high: float) -> Self:
        """The same where it ends at one of these bounds: it may be anywhere beyond, and how far nobody knows."""
        at = next((b for b in (low, high) if b and abs(self.value - b) <= _AT_BOUND * abs(b)), None)
        if at is None:
            return self
        ends = (-math.inf, self.interval_95[1]) if at < 0.0 else (self.interval_95[0], math.inf)
        return replace(self, value=at, std=math.inf, interval_95=ends)

    @property
    def at_bound(self) -> bool:
        """Whether it is known from one side only."""
        return math.isinf(self.interval_95[0]) != math.isinf(self.interval_95[1])

    @classmethod
    def exact(cls, value: float, unit: str) -> Self:
        """A figure that has no interval."""
        return cls(value, float("nan"), unit, (float("nan"), float("nan")))

    def to_json(self) -> dict[str, Any]:
        """Entry of ``parameters``."""
        return {
            "value": finite(self.value),
            "std": finite(self.std),
            "unit": self.unit,
            "interval_95": [finite(self.interval_95[0]), finite(self.interval_95[1])],
            **({"at_bound": True} if self.at_bound else {}),
        }


@dataclass(frozen=True)
class Alternative:
    """An effect that explains the data about as well as the named one."""

    effect: str
    #: Evidence of the named effect against this one (20 is strong; 1 cannot be told apart).
    evidence_ratio: float

    def to_json(self) -> dict[str, Any]:
        """Entry of ``alternatives``."""
        return {"effect": self.effect, "evidence_ratio": finite(self.evidence_ratio)}


@dataclass(frozen=True)
class Improvement:
    """Error on data that the fit did not see, before and after; deg/s.

    Attributes
    ----------
    interval_95 : tuple of float
        Of the drop in held-out rms, by a paired bootstrap of whole blocks.
    logloss_before, logloss_after : float
        Held-out log-loss, nats a data set, each with the noise that its errors show.
    excess_removed : float
        Part of the held-out excess over the noise floor that the model removed.
    scheme : Remark
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
    scheme: Remark

    def to_json(self) -> dict[str, Any]:
        """Entry of ``improvement``."""
        return {
            "heldout_rms_before_dps": finite(self.heldout_rms_before_dps),
            "heldout_rms_after_dps": finite(self.heldout_rms_after_dps),
            "noise_floor_dps": finite(self.noise_floor_dps),
            "interval_95": [finite(x) for x in self.interval_95],
            "logloss_before_nats": finite(self.logloss_before),
            "logloss_after_nats": finite(self.logloss_after),
            "logloss_interval_95": [finite(x) for x in self.logloss_interval_95],
            "excess_removed": finite(self.excess_removed),
        }


@dataclass(frozen=True)
class Layer:
    """A step of the staircase: errors on data left out with everything down to this layer in the model.

    Attributes
    ----------
    name : str
        Effect or block that this step adds; empty for the surface alone.
    heldout_rms_dps, noise_floor_dps : float
        Of data sets left out; what noise alone would leave.
    logloss : float
        Nats a data set.
    """

    name: str
    heldout_rms_dps: float
    noise_floor_dps: float
    logloss: float

    def to_json(self) -> dict[str, Any]:
        """Entry of ``layers``."""
        return {
            "layer": self.name or "surface",
            "heldout_rms_dps": finite(self.heldout_rms_dps),
            "noise_floor_dps": finite(self.noise_floor_dps),
            "logloss_nats": finite(self.logloss),
        }


@dataclass(frozen=True)
class UnnamedPart:
    """Structure that no law of the catalogue takes; it is in the correction where a robot knows its coordinate.

    Attributes
    ----------
    coordinate, family : str
    evidence_nats : float
        What it is worth to the model.
    low, high : float
        The stretch of the coordinate where it is largest, in `unit`.
    nearest : mapping
        Laws to how much evidence they leave of it, nats.
    corrected : bool
        Whether the improved coefficients, or of a difference the law, have it.
    """

    coordinate: str
    family: str
    evidence_nats: float
    rms_dps: float
    low: float | None
    high: float | None
    unit: str
    nearest: Mapping[str, float]
    corrected: bool

    def to_json(self) -> dict[str, Any]:
        """Entry of ``unnamed``."""
        return {
            "coordinate": self.coordinate,
            "family": self.family,
            "evidence_nats": finite(self.evidence_nats),
            "rms_dps": finite(self.rms_dps),
            "from": finite(self.low),
            "to": finite(self.high),
            "unit": self.unit,
            "nearest": [
                {"effect": e, "left_nats": finite(n)}
                for e, n in sorted(self.nearest.items(), key=lambda item: item[1])
            ],
            "corrected": self.corrected,
        }


@dataclass(frozen=True)
class NamedEffect:
    """Physics that the model lacked, named.

    Attributes
    ----------
    share : float
        Share of the evidence for structure of its kind that the law takes; below one the law fits with a lack.
    seen : Remark or None
        What was seen of it in this recording; None: it is what the catalogue says.
    beside : Remark or None
        What there is to say beside that.
    adds : Estimate or None
        What it adds beyond the surface, rms over the rows: known also of parameters that cannot be separated.
    """

    effect: str
    family: str
    parameters: Mapping[str, Estimate]
    p_value: float
    alternatives: tuple[Alternative, ...]
    improvement: Improvement | None
    runtime: bool
    share: float = 1.0
    seen: Remark | None = None
    beside: Remark | None = None
    adds: Estimate | None = None

    def to_json(self) -> dict[str, Any]:
        """Entry of ``effects``, but for its words."""
        return {
            "effect": self.effect,
            "family": self.family,
            "parameters": {k: e.to_json() for k, e in self.parameters.items()},
            "p_value": finite(self.p_value),
            "alternatives": [a.to_json() for a in self.alternatives],
            "improvement": None if self.improvement is None else self.improvement.to_json(),
            "runtime": self.runtime,
            "share_of_evidence": finite(self.share),
            "adds_rms": None if self.adds is None else self.adds.to_json(),
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
            "white_std_dps": finite(self.white_std_dps),
            "angle_random_walk_deg_per_rt_h": finite(self.angle_random_walk_deg_per_rt_h),
            "bias_instability_deg_per_h": finite(self.bias_instability_deg_per_h),
            "rate_random_walk_deg_per_h_per_rt_h": finite(self.rate_random_walk_deg_per_h_per_rt_h),
            "rate_jitter_ppm": finite(self.rate_jitter_ppm),
        }


@dataclass(frozen=True)
class Diagnosis:
    """The answer: verdict, places, names, numbers.

    Attributes
    ----------
    sentences : tuple of str
        What is said of a drive, plainly, in order; of a recording `gyrocal.report.sentences` makes them.
    surface : Coefficients
        The model before: the coefficients given, or fitted here.
    improved : Coefficients or None
        Surface refitted together with the named physics, which is in its ``terms``.
    rows : Rows or None
        What pictures need; not part of the JSON.
    next_experiment : mapping or None
        Filled by `gyrocal.planning.next_experiment`.
    counted_in : str
        What log-losses are counted in where the rows do not tell; not part of the JSON.
    drive : mapping or None
        Of a drive log: every estimate with the metres that it costs, and position errors before and after.
    """

    recording: str
    verdict: Verdict
    located: tuple[Located, ...]
    effects: tuple[NamedEffect, ...]
    not_testable: Mapping[str, Reason]
    sentences: tuple[str, ...]
    noise: NoiseFigures | None
    improvement: Improvement | None
    surface: Coefficients | None
    improved: Coefficients | None
    rows: Rows | None
    notes: tuple[Note, ...] = ()
    next_experiment: Mapping[str, Any] | None = None
    counted_in: str = ""
    drive: Mapping[str, Any] | None = None
    layers: tuple[Layer, ...] = ()
    unnamed: tuple[UnnamedPart, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """All but the words of the document that `diagnose` writes; plain, finite JSON values."""
        return {
            "schema": SCHEMA,
            "recording": self.recording,
            "verdict": self.verdict,
            "located": [place.to_json() for place in self.located],
            "effects": [effect.to_json() for effect in self.effects],
            "unnamed": [part.to_json() for part in self.unnamed],
            "layers": [layer.to_json() for layer in self.layers],
            "improvement": None if self.improvement is None else self.improvement.to_json(),
            "not_testable": list(self.not_testable),
            "noise": None if self.noise is None else self.noise.to_json(),
            "next_experiment": None if self.next_experiment is None else dict(self.next_experiment),
            **({} if self.drive is None else {"drive": dict(self.drive)}),
        }
