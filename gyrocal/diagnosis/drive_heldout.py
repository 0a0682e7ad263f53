"""Held-out gain of named effects on a drive, and the rule that a name has to show one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis import robust
from gyrocal.diagnosis.drive import BLOCK_S, LEVEL, Model, Question, YawFit, explain, refitted
from gyrocal.diagnosis.drive_effects import coordinates
from gyrocal.diagnosis.drive_noise import YawNoise
from gyrocal.diagnosis.drive_series import DriveSeries, bins_of
from gyrocal.diagnosis.result import Improvement

Floats = NDArray[np.float64]

_FOLDS = 10
_BOOTSTRAP = 2000


def explain_with_gain(
    asked: Question, nominal: DriveSeries, seed: int
) -> tuple[YawFit, Improvement | None, dict[str, Improvement], tuple[str, ...]]:
    """Explain a drive; a law that does not lessen the error on data left out, or that a small bias may be, is not named.

    Parameters
    ----------
    nominal : DriveSeries
        The log before anything was corrected: the error before is its.

    Returns
    -------
    tuple
        The fit, the gain of all effects together, of each, and the laws that were found and not named.
    """
    refused: list[str] = []
    while True:
        fit = explain(replace(asked, banned=asked.banned | set(refused)), seed)
        total, each = _improvements(asked, fit, nominal, seed)
        weak = [n for n, gain in each.items() if not gain.interval_95[0] > 0 or fit.p_values[n] > LEVEL]
        if not weak:
            return fit, total, each, tuple(refused)
        refused.append(min(weak, key=lambda n: each[n].interval_95[0]))


def _improvements(
    asked: Question, fit: YawFit, nominal: DriveSeries, seed: int
) -> tuple[Improvement | None, dict[str, Improvement]]:
    """Held-out gain of all named effects together, and of each when it is left out of them."""
    names = fit.model.names()
    if not names and nominal is asked.series:
        return None, {}
    without = {
        name: replace(fit.model, delayed=False, delay_s=0.0)
        if name == "gyro_delay"
        else replace(fit.model, members=tuple(m for m in fit.model.members if m.effect != name))
        for name in names
    }
    width_s, used = fit.bins.width_s, asked.noise.used
    fold = np.arange(fit.bins.t_s.size) * _FOLDS // fit.bins.t_s.size
    after = _heldout(asked, fit.model, fold)
    bare = bins_of(nominal, 0.0)
    before = bare.encoder_deg - bare.gyro_deg
    floor = _floor_dps(asked.series, fit)
    total = _improvement(before[used], after[used], width_s, floor, seed)
    each = {
        name: _improvement(_heldout(asked, model, fold)[used], after[used], width_s, floor, seed)
        for name, model in without.items()
    }
    return total, each


def _heldout(asked: Question, model: Model, fold: NDArray[np.int64]) -> Floats:
    """What a model leaves in bins that its coefficients and its delay were not fitted to, deg a bin."""
    left = np.empty(fold.size)
    for k in range(_FOLDS):
        seen = asked.noise.used & (fold != k)
        moved = refitted(asked.series, model, seen)
        bins = bins_of(asked.series, moved.delay_s)
        y = bins.encoder_deg - bins.gyro_deg
        columns = np.hstack([np.zeros((y.size, 0)), *(m.columns for m in moved.members)])
        values = np.linalg.lstsq(columns[seen], y[seen], rcond=None)[0]
        left[fold == k] = (y - columns @ values)[fold == k]
    return left


def _floor_dps(series: DriveSeries, fit: YawFit) -> float:
    """What is left when curves over every coordinate are fitted beside the named effects, deg/s; slips left out."""
    noise: YawNoise = fit.noise
    columns = np.hstack([c.columns for c in coordinates(series, fit.bins, fit.model.delay_s)])[noise.used]
    rest = fit.after_deg[noise.used]
    left = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
    rank = int(np.linalg.matrix_rank(columns))
    return float(np.sqrt(left @ left / max(left.size - rank, 1))) / fit.bins.width_s


def _improvement(before: Floats, after: Floats, width_s: float, floor: float, seed: int) -> Improvement:
    """Drop of rms and of Gaussian log-loss, by a paired bootstrap of blocks."""
    starts = robust.block_starts(before.size, round(BLOCK_S / width_s))
    squares = np.stack([np.add.reduceat(x**2, starts) for x in (before, after)])
    counts = np.diff(starts, append=before.size)
    rng = np.random.default_rng([seed, 99])
    drawn = rng.integers(0, starts.size, size=(_BOOTSTRAP, starts.size))
    rms = np.sqrt(squares[:, drawn].sum(axis=2) / counts[drawn].sum(axis=1)) / width_s
    drops = np.quantile(rms[0] - rms[1], [0.025, 0.975])
    # Log-loss of a Gaussian whose spread is the residual's own, a block's worth of bins at a time.
    nats = np.log(rms) * float(np.mean(counts))
    gains = np.quantile(nats[0] - nats[1], [0.025, 0.975])
    rms_before, rms_after = (float(np.sqrt(np.mean(x**2))) / width_s for x in (before, after))
    excess = rms_before**2 - floor**2
    removed = (rms_before**2 - rms_after**2) / excess if excess > 0 else float("nan")
    per_block = 0.5 * float(np.mean(counts))
    return Improvement(
        rms_before, rms_after, floor, (float(drops[0]), float(drops[1])),
        per_block * (1 + np.log(2 * np.pi * rms_before**2)), per_block * (1 + np.log(2 * np.pi * rms_after**2)),
        (float(gains[0]), float(gains[1])), float(np.clip(removed, -np.inf, 1.0)),
        f"tenths of the log in turn, yaw rate in bins of {width_s:g} s",
    )  # fmt: skip
