"""Tests for rows whose noise is neither white nor even: whitening by autoregression, nulls by blocks of random sign.

The score wild bootstrap (Kline and Santos, J. Econometric Methods 1, 23, 2012) keeps its level whatever the noise does
inside a block, as long as blocks are independent of each other and symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Order of the autoregression: the memory of a heading difference is a few bins.
AR_ORDER = 6


def autoregression(residual: Floats, most: int = AR_ORDER) -> Floats:
    """Coefficients of the autoregression of `residual`, by Yule and Walker (always stable).

    Its order is that of the least Bayesian information criterion up to `most`: terms that are not there cost coverage.
    """
    x = residual - residual.mean()
    lags = np.array([x[: x.size - k] @ x[k:] for k in range(most + 1)]) / x.size
    best, least = np.zeros(0), x.size * float(np.log(lags[0])) if lags[0] > 0 else -np.inf
    for order in range(1, most + 1):
        toeplitz = lags[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
        phi = np.linalg.solve(toeplitz + 1e-9 * lags[0] * np.eye(order), lags[1 : order + 1])
        left = float(lags[0] - phi @ lags[1 : order + 1])
        criterion = x.size * float(np.log(max(left, 1e-300))) + order * float(np.log(x.size))
        if criterion < least:
            best, least = phi, criterion
    return np.asarray(best)


def whiten(phi: Floats, columns: Floats) -> Floats:
    """``z_t - sum phi_i z_(t-i)`` of each column, the first rows dropped: shape (n - order, k)."""
    order = phi.size
    out = columns[order:].copy()
    for i, p in enumerate(phi, start=1):
        out -= p * columns[order - i : columns.shape[0] - i]
    return out


@dataclass(frozen=True)
class Regression:
    """Whitened least squares: what a model leaves, with blocks of rows that count as independent.

    Attributes
    ----------
    residual : ndarray, shape (n,)
    basis : ndarray, shape (n, p)
        Orthonormal basis of the model's whitened columns.
    blocks : ndarray, shape (b,)
        First row of each block.
    """

    phi: Floats
    residual: Floats
    basis: Floats
    blocks: Ints

    @property
    def rss(self) -> float:
        """Sum of squares that the model leaves."""
        return float(self.residual @ self.residual)

    def free(self, columns: Floats) -> Floats:
        """Whitened columns with the model taken out."""
        white = whiten(self.phi, columns)
        return white - self.basis @ (self.basis.T @ white)


def block_starts(n: int, rows: int) -> Ints:
    """First rows of blocks of at least `rows` rows; at least 20 blocks where there are rows for them."""
    count = max(min(20, n), n // rows)
    return np.unique((np.arange(count) * n) // count)


def regress(y: Floats, model: Floats, phi: Floats, rows_per_block: int) -> Regression:
    """Least squares of whitened `y` on whitened `model` columns, shape (n, p); p may be 0."""
    white = whiten(phi, np.column_stack([y, model]))
    basis = np.linalg.qr(white[:, 1:])[0] if model.shape[1] else np.zeros((white.shape[0], 0))
    residual = white[:, 0] - basis @ (basis.T @ white[:, 0])
    return Regression(phi, residual, basis, block_starts(residual.size, rows_per_block))


@dataclass(frozen=True)
class ScoreTest:
    """Outcome for a family of candidate blocks of columns.

    Attributes
    ----------
    best : int
        Which candidate fits best.
    gain_nats : float
        Log-likelihood that the best one gains, less half the logarithm of the number of blocks for each column.
    p_value : float
        Of the largest statistic of the family.
    """

    best: int
    gain_nats: float
    p_value: float


def score_test(regression: Regression, candidates: Sequence[Floats], signs: Floats) -> ScoreTest:
    """Test whether any candidate (each of shape (rows, k)) belongs in the model.

    Parameters
    ----------
    signs : ndarray, shape (draws, blocks)
        Random signs, the same for all tests of a diagnosis.

    Notes
    -----
    Statistic: ``s' (sum_b S_b S_b')^-1 s`` with S_b the score of block b and s their sum; its null follows from the
    same with random signs. Where no draw comes near, the F distribution with one degree of freedom a block speaks.
    """
    statistics, nulls, gains, tails = [], [], [], []
    for columns in candidates:
        free = _independent(regression.free(columns))
        if free.shape[1] == 0:
            continue
        statistic, tail, scores, inverse = _score(regression, free)
        drawn = signs @ scores
        statistics.append(statistic)
        nulls.append(np.einsum("ij,jk,ik->i", drawn, inverse, drawn))
        gains.append(_gain(regression, free) - 0.5 * free.shape[1] * np.log(regression.blocks.size))
        tails.append(tail)
    if not statistics:
        return ScoreTest(0, -np.inf, 1.0)
    exceeded = int(np.count_nonzero(np.max(nulls, axis=0) >= max(statistics) * (1 - 1e-12)))
    draws = signs.shape[0]
    p_value = (1 + exceeded) / (1 + draws)
    if exceeded < 5:
        p_value = min(p_value, max(min(tails) * len(tails), 1e-16))
    return ScoreTest(int(np.argmax(gains)), float(np.max(gains)), p_value)


def line_test(regression: Regression, columns: Floats) -> tuple[float, float]:
    """Gain in nats (as in `ScoreTest`) and p-value by the F distribution of one block of columns on its own."""
    free = _independent(regression.free(columns))
    if free.shape[1] == 0:
        return -np.inf, 1.0
    penalty = 0.5 * free.shape[1] * np.log(regression.blocks.size)
    return _gain(regression, free) - penalty, _score(regression, free)[1]


def _score(regression: Regression, free: Floats) -> tuple[float, float, Floats, Floats]:
    """Statistic, its tail by the F distribution, the blocks' scores (b, k) and the inverse of their squares."""
    count, k = regression.blocks.size, free.shape[1]
    scores = np.add.reduceat(free * regression.residual[:, None], regression.blocks, axis=0)
    inverse = np.linalg.pinv(scores.T @ scores)
    total = scores.sum(axis=0)
    statistic = float(total @ inverse @ total)
    share = min(statistic / count, 1.0 - 1e-12)
    tail = float(stats.f.sf(share / (1.0 - share) * (count - k) / k, k, max(count - k, 1)))
    return statistic, tail, scores, inverse


def _independent(free: Floats) -> Floats:
    """Columns scaled to unit length, without those that the model already holds."""
    length = np.linalg.norm(free, axis=0)
    kept = free[:, length > 1e-9] / length[length > 1e-9]
    if kept.shape[1] < 2:
        return np.asarray(kept)
    q, r = np.linalg.qr(kept)
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-6])


def _gain(regression: Regression, free: Floats) -> float:
    """Log-likelihood gained by orthogonalised columns, in nats, the variance of the noise estimated."""
    q = np.linalg.qr(free)[0]
    explained = float(np.sum((q.T @ regression.residual) ** 2))
    left = max(regression.rss - explained, 1e-300)
    return 0.5 * regression.residual.size * float(np.log(regression.rss / left))


def fit(
    y: Floats,
    columns: Floats,
    phi: Floats,
    rows_per_block: int,
    nuisance: Floats | None = None,
    held: tuple[Floats, float] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Coefficients (k,), their covariance (k, k) robust within blocks, and its degrees of freedom (k,).

    Parameters
    ----------
    nuisance : ndarray, shape (n, m), optional
        Columns that are taken out first.
    held : (ndarray of shape (n,), float), optional
        A column whose coefficient is known to be zero within this standard deviation.

    Notes
    -----
    The covariance is the jackknife over blocks (CR3 of Bell and McCaffrey 2002): where a few blocks weigh much, the
    plain sandwich is too small. What the held column may do beside is added. The degrees of freedom are those of the
    blocks that a coefficient really leans on (Satterthwaite).
    """
    parts = [y[:, None], columns] if held is None else [y[:, None], columns, held[0][:, None]]
    white = whiten(phi, np.hstack(parts))
    if nuisance is not None and nuisance.shape[1]:
        basis = np.linalg.qr(whiten(phi, nuisance))[0]
        white = white - basis @ (basis.T @ white)
    x, target = white[:, 1:], white[:, 0]
    square, product = x.T @ x, x.T @ target
    left = target - x @ (np.linalg.pinv(square) @ product)
    weight = np.zeros(x.shape[1])
    if held is not None:
        weight[-1] = float(left @ left) / max(target.size - x.shape[1], 1) / held[1] ** 2
    inverse = np.linalg.pinv(square + np.diag(weight))
    values = inverse @ product
    starts = block_starts(target.size, rows_per_block)
    ends = np.append(starts[1:], target.size)
    without, leaning = np.empty((2, starts.size, values.size))
    for k, (begin, end) in enumerate(zip(starts, ends, strict=True)):
        part = x[begin:end]
        rest = square - part.T @ part + np.diag(weight)
        without[k] = np.linalg.pinv(rest) @ (product - part.T @ target[begin:end])
        leaning[k] = np.sum((inverse @ part.T) ** 2, axis=1)
    away = without - values
    count, wanted = max(starts.size - 1, 1), columns.shape[1]
    covariance = count / starts.size * away.T @ away
    freedom = np.clip(
        leaning.sum(axis=0) ** 2 / np.maximum((leaning**2).sum(axis=0), 1e-300) - 1.0, 1.0, count
    )
    if held is not None:
        pulled = inverse[:, -1] * weight[-1] * held[1]
        covariance = covariance + np.outer(pulled, pulled)
    return values[:wanted], covariance[:wanted, :wanted], freedom[:wanted]
