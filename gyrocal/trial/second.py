"""A second run of the same gyro on another plan, without noise: what a correction leaves there."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from gyrocal.calibration.apply import ApplyConfig, apply_recording
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.records.csvio import read_columns, read_header
from gyrocal.trial.conceal import Hidden, coil_c, error_dps
from gyrocal.trial.gyros import Gyro, surface_columns
from gyrocal.trial.plans import Bench

Floats = NDArray[np.float64]

#: In an error up to so many times what the record allows there is nothing to remove, and no share.
WORTH = 1.3
_ROUNDS = 8
_LEAST_SLOPE = 0.02


@dataclass(frozen=True)
class SecondRun:
    """Truth of the second run.

    Attributes
    ----------
    gyro_dps : ndarray, shape (n,)
        Output without noise, with what stays with the gyro.
    inside : ndarray of bool, shape (n,)
        Rows within the temperatures of the first recording.
    open_dps : ndarray, shape (n, k)
        What steps, drifts and walks of the first recording would add to a corrected rate if they lasted: it counts
        either way.
    """

    bench: Bench
    gyro_dps: Floats
    inside: NDArray[np.bool_]
    open_dps: Floats

    def rms_dps(self, corrected_dps: Floats) -> float:
        """Error of a correction: of means of data sets and, half and half in the mean square, of ramps and soaks.

        Infinite where a row has no corrected rate. What is open counts as is best for the correction.
        """
        z = np.column_stack([corrected_dps - self.bench.rate_dps, -self.open_dps])
        if self.bench.is_run:
            rate = self.bench.is_rate
            segments = [self.bench.segment == k for k in np.unique(self.bench.segment[rate])]
            means = np.array([z[rows].mean(axis=0) for rows in segments if self.inside[rows].all()])
            loose = z[~rate & self.inside]
            z = np.vstack([m / np.sqrt(2 * len(m)) for m in (means, loose) if len(m)])
        else:
            z = z[self.inside] / np.sqrt(np.count_nonzero(self.inside))
        if not np.isfinite(z).all():
            return float("inf")
        error, still = z[:, 0], z[:, 1:]
        if still.shape[1]:
            error = error - still @ lsq_linear(still, error, (-1e-9, 1.0 + 1e-9)).x
        return float(np.linalg.norm(error))


def second_run(
    first: Bench, second: Bench, gyro: Gyro, hidden: Sequence[Hidden], walked_dps: float = 0.0
) -> SecondRun:
    """The same gyro on the bench of `second`; its bias had walked by `walked_dps` at the end of the first."""
    stays = [h for h in hidden if h.law.stays]
    lasting = [(h.amplitude, h.law.lasting(second, h.parameters)) for h in hidden]
    still = [amplitude * column for amplitude, column in lasting if column is not None]
    if walked_dps:
        still.append(np.full(second.t_s.size, walked_dps))
    temp_c = second.temp_c

    def error(rate_dps: Floats) -> Floats:
        return error_dps(replace(second, rate_dps=rate_dps), gyro, stays)

    corrected = [column / _slope_over(error, second.rate_dps, column) for column in still]
    return SecondRun(
        second,
        second.rate_dps + error(second.rate_dps),
        (temp_c >= first.temp_c.min()) & (temp_c <= first.temp_c.max()),
        np.column_stack([np.zeros((temp_c.size, 0)), *corrected]),
    )


def _slope_over(error: Callable[[Floats], Floats], rate_dps: Floats, reach_dps: Floats) -> Floats:
    """Slope of the output over as far as it is moved: a jump of the error at rest is no slope."""
    h = np.maximum(np.abs(reach_dps), 1e-5 * float(np.abs(rate_dps).max()))
    return np.maximum(1.0 + (error(rate_dps + h) - error(rate_dps - h)) / (2.0 * h), _LEAST_SLOPE)


def slope_of(error: Callable[[Floats], Floats], rate_dps: Floats) -> Floats:
    """Slope of an error over the rate, by differences."""
    h = 1e-5 * float(np.abs(rate_dps).max())
    return np.asarray((error(rate_dps + h) - error(rate_dps - h)) / (2.0 * h))


@dataclass(frozen=True)
class Oracle:
    """What least squares leaves on the second run that knows the laws, their shapes and the noise, and fits only sizes.

    Attributes
    ----------
    rms_dps : float
        What it left.
    expected_dps : float
        Standard deviation of its prediction within the temperatures of the first recording.
    """

    rms_dps: float
    expected_dps: float

    @property
    def allowed_dps(self) -> float:
        """Error that the noise of the recording allows, whether the oracle was lucky or not."""
        return max(self.rms_dps, self.expected_dps)


def consult_oracle(
    first: Bench, gyro_dps: Floats, second: SecondRun, gyro: Gyro, hidden: Sequence[Hidden]
) -> Oracle:
    """Fit as the oracle does: a front end's sine is known whole, and the surface lives at the coil's temperature."""
    known = [h for h in hidden if h.law.acts == "front"]
    sized = [h for h in hidden if h.law.acts == "adds"]

    def design(bench: Bench, laws: Sequence[Hidden]) -> Floats:
        return np.column_stack(
            [surface_columns(bench, coil_c(bench, hidden)), *(h.column(bench) for h in laws)]
        )

    y = (
        gyro_dps
        - first.rate_dps
        - np.sum([np.zeros(first.t_s.size), *(h.column(first) for h in known)], axis=0)
    )
    white = gyro.noise.whiten(first, np.column_stack([design(first, sized), y]))
    size = np.linalg.norm(white[:, :-1], axis=0)
    size[size == 0] = 1.0
    inverse = np.linalg.pinv(white[:, :-1] / size, rcond=1e-10) / size[:, None]
    fitted = inverse @ white[:, -1]
    staying = np.array([True] * (fitted.size - len(sized)) + [h.law.stays for h in sized])

    def predicted(rate_dps: Floats) -> Floats:
        bench = replace(second.bench, rate_dps=rate_dps)
        sum_dps = design(bench, sized)[:, staying] @ fitted[staying]
        return np.asarray(np.sum([sum_dps, *(h.column(bench) for h in known)], axis=0))

    left = second.rms_dps(inverted(second.gyro_dps, second.bench.rate_dps, predicted))
    spread = design(second.bench, sized)[second.inside][:, staying] @ inverse[staying]
    return Oracle(left, float(np.sqrt(np.mean(np.sum(spread**2, axis=1)))))


def inverted(output_dps: Floats, start_dps: Floats, error: Callable[[Floats], Floats]) -> Floats:
    """True rates whose output is `output_dps`, by Newton's method from `start_dps`."""
    rate = start_dps
    for _ in range(_ROUNDS):
        slope = np.maximum(1.0 + slope_of(error, rate), _LEAST_SLOPE)
        rate = rate - (rate + error(rate) - output_dps) / slope
    return rate


def corrected_rms_dps(recording: Path, second: SecondRun, coefficients: Coefficients | None) -> float | None:
    """Error that a coefficient file leaves on the second run, through `gyrocal apply`; None without a file."""
    if coefficients is None:
        return None
    with tempfile.TemporaryDirectory(prefix="gyrocal-second-") as place:
        model, out = Path(place) / "model.json", Path(place) / "corrected.csv"
        model.write_text(coefficients.to_text(), encoding="utf-8")
        apply_recording(ApplyConfig(recording, model, out, force_sensor=True), lambda share, what: None)
        return second.rms_dps(read_columns(out, read_header(out))["corrected_dps"])


def share_removed(before: float | None, after: float | None, oracle: Oracle) -> float | None:
    """Share of the removable error that is removed: 1 all, 0 none, below 0 worse; None where there is none to remove.

    A correction with rows that it cannot correct removes nothing.
    """
    if before is None or not WORTH * oracle.allowed_dps < before < float("inf"):
        return None
    if after is None or after == float("inf"):
        return 0.0
    return (before - after) / (before - oracle.rms_dps)
