"""Dead reckoning against truth: one frame laid on the other by a stated method, and the errors that remain."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

Floats = NDArray[np.float64]

#: The methods, in words for the output.
METHODS = {
    "start": "start pose: position and heading of the truth at its first row; nothing is estimated",
    "headings": "rotation by the mean difference of headings; positions begin at the origin",
    "positions": "rotation and shift by least squares on all truth positions (three parameters; sigma by delete-a-block jackknife, 10 blocks)",
}
_BLOCKS = 10
#: A path is closed when it ends nearer to its start than this share of its length.
_CLOSED_SHARE = 0.02


@dataclass(frozen=True)
class Alignment:
    """Where the dead-reckoned frame lies in that of the truth: ``truth = R(rotation) estimate + shift``.

    `sigma` holds the standard deviations of (rotation_deg, x_m, y_m), zero where nothing is estimated.
    """

    method: str
    rotation_deg: float
    x_m: float
    y_m: float
    sigma: tuple[float, float, float]

    def apply(self, x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
        """Positions in the frame of the truth."""
        c, s = math.cos(self.rotation_deg * DEG_TO_RAD), math.sin(self.rotation_deg * DEG_TO_RAD)
        return c * x_m - s * y_m + self.x_m, s * x_m + c * y_m + self.y_m


@dataclass(frozen=True)
class PositionErrors:
    """Distances between aligned estimate and truth, m; `return_m` only where the path ends at its start."""

    rows: int
    rms_m: float
    max_m: float
    end_m: float
    return_m: float | None


@dataclass(frozen=True)
class HeadingErrors:
    """Aligned less true headings, deg."""

    rows: int
    rms_deg: float
    max_deg: float
    end_deg: float


def wrapped_deg(angle_deg: Floats) -> Floats:
    """Angles between -180 and 180 deg."""
    return np.asarray((angle_deg + 180.0) % 360.0 - 180.0)


def align_headings(estimate_deg: Floats, truth_deg: Floats) -> Alignment:
    """Rotation by the mean difference of headings, shape (n,); positions stay where they start."""
    apart = truth_deg - estimate_deg
    near = float(RAD_TO_DEG * np.angle(np.mean(np.exp(1j * DEG_TO_RAD * apart))))
    rotation_deg = near + float(np.mean(wrapped_deg(apart - near)))
    return Alignment("headings", rotation_deg, 0.0, 0.0, (0.0, 0.0, 0.0))


def heading_errors(aligned_deg: Floats, truth_deg: Floats) -> HeadingErrors:
    """Errors of aligned headings, shape (n,), against truth."""
    error = wrapped_deg(aligned_deg - truth_deg)
    return HeadingErrors(
        int(error.size),
        float(np.sqrt(np.mean(error**2))),
        float(np.max(np.abs(error))),
        float(error[-1]),
    )


def align_start(estimate: Floats, truth: Floats) -> Alignment:
    """Lay the pose (x_m, y_m, heading_deg) of the estimate at the first truth row on that of the truth."""
    rotation_deg = float(truth[2] - estimate[2])
    turned = Alignment("start", rotation_deg, 0.0, 0.0, (0.0, 0.0, 0.0)).apply(estimate[0], estimate[1])
    return Alignment(
        "start", rotation_deg, float(truth[0] - turned[0]), float(truth[1] - turned[1]), (0.0, 0.0, 0.0)
    )


def align_positions(estimate: Floats, truth: Floats) -> Alignment:
    """Least-squares rotation and shift between positions, shape (n, 2) each.

    The errors of dead reckoning grow slowly, so neighbours are not independent: the standard deviations come
    from leaving out a tenth of the path at a time (delete-a-block jackknife).
    """
    fitted = _fit(estimate, truth)
    blocks = min(_BLOCKS, estimate.shape[0] // 2)
    if blocks < 2:
        return Alignment("positions", *fitted, (math.nan, math.nan, math.nan))
    groups = np.array_split(np.arange(estimate.shape[0]), blocks)
    left_out = np.array([_fit(np.delete(estimate, g, axis=0), np.delete(truth, g, axis=0)) for g in groups])
    # Rotations are compared around the full fit, or those near +-180 deg would seem to scatter by 360.
    spread = left_out - np.array(fitted)
    spread[:, 0] = wrapped_deg(spread[:, 0])
    spread -= spread.mean(axis=0)
    sigma = np.sqrt((blocks - 1) / blocks * np.sum(spread**2, axis=0))
    return Alignment("positions", *fitted, (float(sigma[0]), float(sigma[1]), float(sigma[2])))


def _fit(estimate: Floats, truth: Floats) -> tuple[float, float, float]:
    middle_e, middle_t = estimate.mean(axis=0), truth.mean(axis=0)
    e, t = estimate - middle_e, truth - middle_t
    cross = float(np.sum(e[:, 0] * t[:, 1] - e[:, 1] * t[:, 0]))
    dot = float(np.sum(e * t))
    rotation = math.atan2(cross, dot)
    c, s = math.cos(rotation), math.sin(rotation)
    x_m = middle_t[0] - c * middle_e[0] + s * middle_e[1]
    y_m = middle_t[1] - s * middle_e[0] - c * middle_e[1]
    return rotation * RAD_TO_DEG, float(x_m), float(y_m)


def position_errors(aligned: Floats, truth: Floats, length_m: float) -> PositionErrors:
    """Errors of aligned positions, shape (n, 2), against truth; `length_m` is the length of the path."""
    distance = np.hypot(*(aligned - truth).T)
    closed = math.dist(truth[0], truth[-1]) < _CLOSED_SHARE * length_m
    end_m = float(distance[-1])
    return PositionErrors(
        int(distance.size),
        float(np.sqrt(np.mean(distance**2))),
        float(distance.max()),
        end_m,
        end_m if closed else None,
    )
