"""The coefficient file, ``gyrocal-coefficients/1`` or ``/2``: what `fit` and `diagnose` write and the runtime reads."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import CoefficientError, InputError
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.surface import RATE_ORDER, SHAPE, TEMPERATURE_ORDER, Surface
from gyrocal.physics.terms import Part, Term, read_term, sensitivity, solve_rate

Floats = NDArray[np.float64]

SCHEMA_NAME = "gyrocal-coefficients"
#: The version read; a file that programs of version 1 understand is written as one.
SCHEMA_VERSION = 2

#: Flags of `Coefficients.flags` and `Compensator`: 0 is inside the valid range. Not finite is also a rate that no
#: solution has; FLAG_TERM is a term beyond what it was fitted to (8 and 16 are those of a recording's samples).
FLAG_RATE = 1
FLAG_TEMPERATURE = 2
FLAG_NOT_FINITE = 4
FLAG_TERM = 32

_TERMS = SHAPE[0] * SHAPE[1]


@dataclass(frozen=True)
class Valid:
    """Range that the calibration data cover; outside it the runtime flags."""

    rate_dps: tuple[float, float]
    temp_c: tuple[float, float]


@dataclass(frozen=True)
class Noise:
    """Noise figures, each ``(value, low, high)`` with a 95 % interval; None where the record carries none."""

    angle_random_walk_deg_per_rt_h: tuple[float, float, float] | None = None
    bias_instability_deg_per_h: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Coefficients:
    """A calibration: surface, its covariance, where it holds, and where it comes from.

    Attributes
    ----------
    covariance_dps2 : ndarray, shape (12, 12), (deg/s)^2
        Covariance of the coefficients, row-major over (i, j).
    """

    sensor: Mapping[str, Any]
    surface: Surface
    covariance_dps2: Floats
    valid: Valid
    noise: Noise = Noise()
    terms: tuple[Term | SmoothTerm, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        covariance = np.asarray(self.covariance_dps2, dtype=np.float64)
        if covariance.shape != (_TERMS, _TERMS):
            msg = f"the covariance is {_TERMS} x {_TERMS}, and {covariance.shape} was given"
            raise ValueError(msg)
        object.__setattr__(self, "covariance_dps2", covariance)

    def runtime_terms(self) -> tuple[Part, ...]:
        """The terms that a robot evaluates; CoefficientError where it cannot."""
        return tuple(term.part() for term in self.terms if term.runtime)

    def correct(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Any:
        """Corrected rate (paper eqs. 1 and 5), deg/s; scalar in, float out. NaN where no rate has this output.

        Runtime terms without memory are applied too; CoefficientError where one needs `Compensator`.
        """
        gyro, temp = np.broadcast_arrays(np.asarray(gyro_dps, float), np.asarray(temp_c, float))
        terms = self.runtime_terms()
        for term in terms:
            if term.has_memory or "since_power_on_s" in term.channels:
                raise CoefficientError(
                    f"The coefficients hold {term.name}, which depends on time: use gyrocal.fusion.Compensator."
                )
        g = gyro.ravel()
        c = Conditions(np.zeros(g.size), g, temp.ravel())
        corrected = solve_rate(self.surface, terms, [None] * len(terms), g, c).rate_dps.reshape(gyro.shape)
        return float(corrected) if corrected.ndim == 0 else corrected

    def sigma_dps(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Any:
        """Standard deviation of the rate corrected by the surface (coefficient uncertainty only), deg/s."""
        gyro, temp = np.broadcast_arrays(np.asarray(gyro_dps, float), np.asarray(temp_c, float))
        by = self.sensitivity(gyro.ravel(), temp.ravel())
        variance = ((by @ self.covariance_dps2) * by).sum(axis=1)
        sigma = np.sqrt(np.maximum(variance, 0.0)).reshape(gyro.shape)
        return float(sigma) if sigma.ndim == 0 else sigma

    def sensitivity(self, gyro_dps: Floats, temp_c: Floats) -> Floats:
        """Derivatives of the rate corrected by the surface by its coefficients, shape (n, 12)."""
        c = Conditions(np.zeros(gyro_dps.size), gyro_dps, temp_c)
        return sensitivity(self.surface, (), (), solve_rate(self.surface, (), (), gyro_dps, c), c, ())

    def flags(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> NDArray[np.int64]:
        """Bits: 1 output outside the valid range, 2 temperature outside, 4 not finite. 0 is good."""
        gyro, temp = np.broadcast_arrays(np.asarray(gyro_dps, float), np.asarray(temp_c, float))
        rate = (gyro < self.valid.rate_dps[0]) | (gyro > self.valid.rate_dps[1])
        temperature = (temp < self.valid.temp_c[0]) | (temp > self.valid.temp_c[1])
        finite = np.isfinite(gyro) & np.isfinite(temp)
        flags = FLAG_RATE * rate + FLAG_TEMPERATURE * temperature + FLAG_NOT_FINITE * ~finite
        return np.asarray(flags, dtype=np.int64)

    def _version(self) -> int:
        smooth = any(isinstance(term, SmoothTerm) for term in self.terms)
        return 2 if smooth or self.surface.direction == "input" else 1

    def to_text(self) -> str:
        """The file's text, indented for people, with the sha256 over its canonical form."""
        body: dict[str, Any] = {
            "schema": f"{SCHEMA_NAME}/{self._version()}",
            "sensor": dict(self.sensor),
            "surface": self.surface.to_json() | {"covariance_dps2": self.covariance_dps2.tolist()},
            "valid": {"rate_dps": list(self.valid.rate_dps), "temp_c": list(self.valid.temp_c)},
            "terms": [term.to_json() for term in self.terms],
            "noise": {name: _interval_to_json(value) for name, value in vars(self.noise).items()},
            "figures": dict(self.figures),
            "provenance": dict(self.provenance),
        }
        return json.dumps(body | {"sha256": _digest(body)}, indent=1, sort_keys=True, allow_nan=False) + "\n"


def _interval_to_json(interval: tuple[float, float, float] | None) -> dict[str, Any] | None:
    return None if interval is None else {"value": interval[0], "interval_95": [interval[1], interval[2]]}


def _interval_from_json(raw: Any) -> tuple[float, float, float] | None:
    return None if raw is None else (float(raw["value"]), *_pair(raw["interval_95"]))


def _pair(raw: Any) -> tuple[float, float]:
    return float(raw[0]), float(raw[1])


def _digest(body: Mapping[str, Any]) -> str:
    canonical = json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def load_coefficients(path: str | Path) -> Coefficients:
    """Read a coefficient file; InputError where it cannot be read, CoefficientError where it is not sound."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise CoefficientError(f"{path}: is not a coefficient file (not UTF-8 text).") from error
    except IsADirectoryError as error:
        raise InputError(
            f"{path}: is a directory, and a coefficient file of `fit` is wanted here."
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}). Check the path.") from error
    return parse_coefficients(text, str(path))


def parse_coefficients(text: str, name: str) -> Coefficients:
    """Check and decode the text of a coefficient file; `name` stands in the messages."""
    try:
        body = json.loads(text)
    except (ValueError, RecursionError) as error:
        if text.strip() and not text.lstrip().startswith("{"):
            raise CoefficientError(
                f"{name}: is not a coefficient file, which `fit` writes as JSON. Check the order of what was given."
            ) from error
        raise CoefficientError(
            f"{name}: is not JSON ({error}); the file is truncated or damaged. Fit again."
        ) from error
    _check_schema(body, name)
    stated = body.pop("sha256", None)
    if stated is None:
        raise CoefficientError(f"{name}: sha256 is missing; the file was edited or cut. Fit again.")
    try:
        actual = _digest(body)
    except ValueError as error:
        raise CoefficientError(f"{name}: holds NaN or infinity; the file was edited. Fit again.") from error
    if stated != actual:
        raise CoefficientError(
            f"{name}: its sha256 does not fit its contents; the file was edited. Use the original or fit again."
        )
    try:
        return _decode(body)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise CoefficientError(
            f"{name}: is malformed ({type(error).__name__}: {error}). Fit again."
        ) from error


def _check_schema(body: Any, name: str) -> None:
    schema = str(body.get("schema", "")) if isinstance(body, dict) else ""
    family, _, version = schema.partition("/")
    if family != SCHEMA_NAME or not (version.isdecimal() and len(version) < 10):
        raise CoefficientError(
            f"{name}: is not a coefficient file (schema {schema!r}, wanted {SCHEMA_NAME}/{SCHEMA_VERSION})."
        )
    if int(version) > SCHEMA_VERSION:
        raise CoefficientError(
            f"{name}: schema {schema} is newer than this program reads ({SCHEMA_NAME}/{SCHEMA_VERSION}). Update gyrocal."
        )


def _decode(body: dict[str, Any]) -> Coefficients:
    raw = body["surface"]
    if (raw["rate_order"], raw["temperature_order"]) != (RATE_ORDER, TEMPERATURE_ORDER):
        msg = f"the surface is of order {raw['rate_order']} x {raw['temperature_order']}, and {RATE_ORDER} x {TEMPERATURE_ORDER} is read"
        raise ValueError(msg)
    surface = Surface(
        np.array(raw["coefficients_dps"], dtype=np.float64),
        float(raw["rate"]["center_dps"]),
        float(raw["rate"]["scale_dps"]),
        float(raw["temperature"]["center_c"]),
        float(raw["temperature"]["scale_c"]),
        raw.get("direction", "output"),
    )
    noise = dict(body.get("noise") or {})
    return Coefficients(
        sensor=dict(body["sensor"]),
        surface=surface,
        covariance_dps2=np.array(raw["covariance_dps2"], dtype=np.float64).reshape(_TERMS, _TERMS),
        valid=Valid(_pair(body["valid"]["rate_dps"]), _pair(body["valid"]["temp_c"])),
        noise=Noise(**{f.name: _interval_from_json(noise.get(f.name)) for f in fields(Noise)}),
        terms=tuple(read_term(entry) for entry in body.get("terms", [])),
        figures=dict(body.get("figures") or {}),
        provenance=dict(body.get("provenance") or {}),
    )
