"""Does the model predict what it did not see? Whole data sets, temperatures and sweeps are left out.

Cross-validation is a demonstration here, never a gate: as a gate it names effects in three of four recordings
that have none (physics.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.improve import Refined
from gyrocal.diagnosis.result import Improvement
from gyrocal.diagnosis.series import Series
from gyrocal.diagnosis.shapes import Piece
from gyrocal.diagnosis.whitening import NoiseModel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_FOLDS = 8
_SIMULATIONS = 12
_BOOTSTRAP = 1000
#: Noise of a prediction, in units of the usual one, from which on it is an extrapolation.
_EXTRAPOLATED = 4.0


@dataclass(frozen=True)
class _Heldout:
    """Per data set: squared error of its mean and log-loss, for each model; shape (sets, models)."""

    squares: Floats
    logloss: Floats
    floor2: Floats
    blocks: Ints


def improvements(
    analysis: Analysis, refined: Refined, seed: int
) -> tuple[dict[str, Improvement], Improvement | None]:
    """Improvement by each named effect, and by all of them together; empty where nothing was named."""
    if not refined.pieces:
        return {}, None
    series = analysis.setup.series
    named = list(refined.pieces)
    # Models: surface alone, all that is named, and all but one of it each.
    models: list[list[Piece]] = [[], named, *([q for q in named if q is not p] for p in named)]
    rng = np.random.default_rng([seed, 7])
    noise = analysis.setup.model.simulate(analysis.levels, rng, _SIMULATIONS)
    folds = _fold_numbers(series)
    parts = [_leave_out(analysis, models, fold, k, noise) for k, fold in enumerate(folds)]
    squares = np.concatenate([p.squares for p in parts])
    logloss = np.concatenate([p.logloss for p in parts])
    floor2 = np.concatenate([p.floor2 for p in parts])
    blocks = np.concatenate([p.blocks for p in parts])
    # What noise alone moves this much is extrapolated from what is left (the only ramp, the only temperature):
    # no model is judged by it.
    sure = floor2 < _EXTRAPOLATED**2 * np.median(floor2)
    result = _Heldout(squares[sure], logloss[sure], floor2[sure], blocks[sure])
    each = {p.member.hypothesis.id: _improvement(result, 2 + k, 1, rng) for k, p in enumerate(named)}
    return each, _improvement(result, 0, 1, rng)


def _fold_numbers(series: Series) -> list[Ints]:
    """Sets to leave out together: interleaved data sets, then whole temperatures or sweeps."""
    numbers = np.unique(_units(series))
    interleaved = [numbers[k::_FOLDS] for k in range(_FOLDS)]
    sweeps = _sweeps(series)
    if len(sweeps) < 3:
        return interleaved
    return interleaved + sweeps


def _units(series: Series) -> Ints:
    """What is left out together at the least: a segment, or a stretch of time in a record of few segments."""
    if np.unique(series.set_index).size >= _FOLDS:
        return series.set_index
    share = (series.t_s - series.t_s[0]) / max(float(np.ptp(series.t_s)), 1e-9)
    return np.asarray(np.minimum(share * 5 * _FOLDS, 5 * _FOLDS - 1), dtype=np.int64)


def _sweeps(series: Series) -> list[Ints]:
    """Groups of neighbouring segments at one temperature: a ramp or a jump begins a new one."""
    numbers, first = np.unique(series.set_index, return_index=True)
    if numbers.size < 12:
        return []
    temps = np.array(
        [float(np.mean(series.temp_c[series.set_index == n])) for n in numbers[series.is_set[first]]]
    )
    sets = numbers[series.is_set[first]]
    if sets.size < 12:
        return []
    starts = np.flatnonzero((np.abs(np.diff(temps)) > 3.0) | (np.diff(sets) > 2)) + 1
    groups = [g for g in np.split(sets, starts) if g.size >= 3]
    return groups if 3 <= len(groups) <= 20 else []


def _leave_out(
    analysis: Analysis, models: Sequence[Sequence[Piece]], fold: Ints, number: int, noise: Floats
) -> _Heldout:
    setup, series = analysis.setup, analysis.setup.series
    units = _units(series)
    out = np.isin(units, fold)
    train, test = NoiseModel(series.take(~out)), NoiseModel(series.take(out))
    y = np.column_stack([setup.base.residual_dps, noise])
    pieces = list(models[1])
    laws = [p.columns for p in pieces]
    design = np.concatenate([setup.base.design, *laws], axis=1)
    everything = np.column_stack([y, design])
    white_train = train.whiten(analysis.levels, everything[~out])[0]
    white_test, _ = test.whiten(analysis.levels, everything[out])
    m, p = y.shape[1], setup.base.design.shape[1]
    spans, first = [], m + p
    for law in laws:
        spans.append(np.arange(first, first + law.shape[1]))
        first += law.shape[1]
    squares, logloss = [], []
    floor2 = np.empty(0)
    sets, inverse = np.unique(units[out], return_inverse=True)
    weight = 1.0 / series.white_std_dps[out] ** 2
    for k, chosen in enumerate(models):
        columns = np.concatenate(
            [np.arange(m, m + p), *(s for s, q in zip(spans, pieces, strict=True) if q in chosen)]
        )
        scale = np.maximum(np.linalg.norm(white_train[:, columns], axis=0), 1e-300)
        solution = (
            np.linalg.lstsq(white_train[:, columns] / scale, white_train[:, :m], rcond=1e-9)[0]
            / scale[:, None]
        )
        left = everything[out][:, :m] - everything[out][:, columns] @ solution
        if analysis.levels.walk:
            # The fit of a bias that walks refers to its first row; what predicts is the mean of what was seen.
            left -= np.mean(everything[~out][:, :m] - everything[~out][:, columns] @ solution, axis=0)
        totals = np.column_stack([np.bincount(inverse, weights=weight * column) for column in left.T])
        means = totals / np.bincount(inverse, weights=weight)[:, None]
        squares.append(means[:, 0] ** 2)
        if k == 1:
            floor2 = np.mean(means[:, 1:] ** 2, axis=1)
        innovation = white_test[:, 0] - white_test[:, columns] @ solution[:, 0]
        logloss.append(np.bincount(inverse, weights=0.5 * innovation**2))
    return _Heldout(np.column_stack(squares), np.column_stack(logloss), floor2, np.full(sets.size, number))


def _improvement(result: _Heldout, before: int, after: int, rng: np.random.Generator) -> Improvement:
    squares = result.squares[:, [before, after]]
    logloss = result.logloss[:, [before, after]]
    rms = np.sqrt(squares.mean(axis=0))
    draws = rng.integers(0, len(squares), (_BOOTSTRAP, len(squares)))
    drop = np.sqrt(squares[draws, 0].mean(axis=1)) - np.sqrt(squares[draws, 1].mean(axis=1))
    nats = (logloss[draws, 0] - logloss[draws, 1]).mean(axis=1)
    floor = float(np.sqrt(result.floor2.mean()))
    excess = float(rms[0] ** 2 - floor**2)
    removed = float((rms[0] ** 2 - rms[1] ** 2) / excess) if excess > 0.02 * floor**2 else float("nan")
    low, high = np.quantile(drop, [0.025, 0.975])
    nats_low, nats_high = np.quantile(nats, [0.025, 0.975])
    means = logloss.mean(axis=0)
    return Improvement(
        float(rms[0]),
        float(rms[1]),
        floor,
        (float(low), float(high)),
        float(means[0]),
        float(means[1]),
        (float(nats_low), float(nats_high)),
        min(removed, 1.0) if np.isfinite(removed) else removed,
        "whole data sets (every eighth segment) and whole temperatures or sweeps in turn",
    )
