"""Tests in the whitened space. All of them are algebra on the Gram matrix of the whitened columns.

Whitened noise is white and Gaussian, so a block of columns that explains nothing gains a chi-square, and the
largest gain over a grid of columns has a null that Monte Carlo draws exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A column that the model captures but for this share of its norm says nothing beyond the model.
_CAPTURED = 1e-7
#: Two columns of one block nearer to parallel than this are one.
_PARALLEL = 1e-6


@dataclass(frozen=True)
class Projection:
    """Inner products of all columns after the model's columns are projected out.

    Attributes
    ----------
    gram : ndarray, shape (p, p)
        Of the columns.
    score : ndarray, shape (p,)
        Of the columns with the record.
    norm : ndarray, shape (p,)
        Squared norms before the projection: what `gram` is compared with to see what is captured.
    rss : float
        Squared norm of the record that is left.
    """

    gram: Floats
    score: Floats
    norm: Floats
    rss: float

    def gains(self, points: Ints) -> Floats:
        """Drop of the residual sum of squares for each point of a grid.

        Parameters
        ----------
        points : ndarray of int, shape (g, k)
            Column numbers: g alternatives of k columns each.

        Returns
        -------
        ndarray, shape (g,)
        """
        if points.shape[1] == 1:
            index = points[:, 0]
            diagonal = self.gram[index, index]
            usable = diagonal > _CAPTURED * self.norm[index]
            return np.where(usable, self.score[index] ** 2 / np.where(usable, diagonal, 1.0), 0.0)
        if points.shape[1] == 2:
            return self._pair_gains(points)
        return np.array([self.block(row)[0] for row in points])

    def _pair_gains(self, points: Ints) -> Floats:
        i, j = points.T
        usable = np.minimum(
            self.gram[i, i] - _CAPTURED * self.norm[i], self.gram[j, j] - _CAPTURED * self.norm[j]
        )
        a, d, c = self.gram[i, i], self.gram[j, j], self.gram[i, j]
        determinant = a * d - c**2
        usable = (usable > 0) & (determinant > _PARALLEL * a * d)
        x, y = self.score[i], self.score[j]
        gains = (d * x**2 - 2.0 * c * x * y + a * y**2) / np.where(usable, determinant, 1.0)
        for row in np.flatnonzero(~usable):
            gains[row] = self.block(points[row])[0]
        return np.asarray(gains)

    def restricted(self, columns: Ints) -> Floats:
        """Gram matrix, record in row 0, of some of the columns."""
        inner = np.empty((columns.size + 1, columns.size + 1))
        inner[0, 0] = self.rss
        inner[0, 1:] = inner[1:, 0] = self.score[columns]
        inner[1:, 1:] = self.gram[np.ix_(columns, columns)]
        return inner

    def block(self, columns: Ints) -> tuple[float, int]:
        """Chi-square of a block of columns, and its degrees of freedom."""
        if columns.size == 0:
            return 0.0, 0
        scale = np.sqrt(np.maximum(self.norm[columns], 1e-300))
        A = self.gram[np.ix_(columns, columns)] / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(A)
        kept = values > max(_PARALLEL * max(values[-1], 0.0), _CAPTURED)
        if not kept.any():
            return 0.0, 0
        along = vectors[:, kept].T @ (self.score[columns] / scale)
        return float(np.sum(along**2 / values[kept])), int(kept.sum())


def project(gram: Floats, model: Ints, mixtures: Floats | None = None) -> Projection:
    """Project a model out of a Gram matrix whose row 0 is the record.

    Parameters
    ----------
    gram : ndarray, shape (1 + p, 1 + p)
    model : ndarray of int
        Column numbers (from 0, the record not counted); may be collinear.
    mixtures : ndarray, shape (p, m), optional
        Further model columns, as mixtures of the columns.
    """
    norm = np.diag(gram).copy()
    cross = gram[model + 1]
    inner = cross[:, model + 1]
    if mixtures is not None and mixtures.size:
        mixed = mixtures.T @ gram[1:]
        inner = np.block([[inner, mixed[:, model + 1].T], [mixed[:, model + 1], mixed[:, 1:] @ mixtures]])
        cross = np.concatenate([cross, mixed])
    if cross.size:
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        values, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
        kept = values > 1e-10 * values[-1]
        half = (vectors[:, kept] / np.sqrt(values[kept])).T @ (cross / scale[:, None])
        gram = gram - half.T @ half
    return Projection(gram[1:, 1:], gram[1:, 0].copy(), norm[1:], float(gram[0, 0]))


def effective_trials(
    projection: Projection, points: Ints, rng: np.random.Generator, draws: int = 2000
) -> float:
    """How many independent trials the best of a grid is worth.

    The ratio between the exact tail of the largest gain over the grid, by Monte Carlo under the fitted noise,
    and the chi-square tail of one point, where the former is 5 %.
    """
    g, k = points.shape
    if g == 1:
        return 1.0
    columns = points.ravel()
    A = projection.gram[np.ix_(columns, columns)]
    scale = np.sqrt(np.maximum(projection.norm[columns], 1e-300))
    A = A / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(A)
    kept = values > 1e-9 * max(values[-1], 1e-300)
    root = vectors[:, kept] * np.sqrt(values[kept])
    z = rng.standard_normal((draws, int(kept.sum()))) @ root.T
    best = np.zeros(draws)
    for i in range(g):
        part = slice(i * k, (i + 1) * k)
        block = A[part, part]
        if k == 1:
            if block[0, 0] > _CAPTURED:
                best = np.maximum(best, z[:, i] ** 2 / block[0, 0])
            continue
        lam, vec = np.linalg.eigh(block)
        good = lam > max(_PARALLEL * lam[-1], _CAPTURED)
        along = z[:, part] @ vec[:, good]
        best = np.maximum(best, np.sum(along**2 / lam[good], axis=1))
    threshold = float(np.quantile(best, 0.95))
    return max(1.0, 0.05 / float(chi2.sf(threshold, k)))


def tail(gain: float, df: int, trials: float = 1.0) -> float:
    """P-value of the largest of so many chi-square gains."""
    if df == 0:
        return 1.0
    return float(min(1.0, trials * chi2.sf(gain, df)))


def log_evidence(gains: Floats, df: int, n: int, weights: Floats) -> float:
    """Evidence of a block against nothing, nats: mean likelihood over its grid, BIC for its amplitudes.

    The mean over the grid, not its maximum, is what makes a law with a free shape pay for that freedom; `weights`,
    which add up to one, say how much of the shapes that could have been each point stands for.
    """
    if gains.size == 0:
        return -np.inf
    half = 0.5 * gains
    top = float(half.max())
    return top + float(np.log(weights @ np.exp(half - top))) - 0.5 * df * float(np.log(n))


def random_evidence(projection: Projection, columns: Ints) -> float:
    """Evidence of a block whose amplitudes are independent draws of one unknown size, nats.

    The size is averaged over a net of octaves, so nothing is tuned. A block of k amplitudes pays for what the
    draws could have been, not a fixed price for each.
    """
    A, b = projection.gram[np.ix_(columns, columns)], projection.score[columns]
    values, vectors = np.linalg.eigh(A)
    kept = values > _CAPTURED * float(np.max(projection.norm[columns]))
    if not kept.any():
        return -np.inf
    lam, along = values[kept], (vectors[:, kept].T @ b) ** 2
    size2 = np.geomspace(0.3, 1e7, 48)[:, None] / float(np.median(lam))
    each = 0.5 * along * size2 / (1.0 + size2 * lam) - 0.5 * np.log1p(size2 * lam)
    total = each.sum(axis=1)
    return float(total.max() + np.log(np.mean(np.exp(total - total.max()))))


def holm(p_values: Floats, level: float) -> NDArray[np.bool_]:
    """Holm's step-down: which hypotheses are rejected with family-wise error `level`, shape (m,)."""
    order = np.argsort(p_values)
    m = p_values.size
    passed = np.zeros(m, dtype=bool)
    for rank, index in enumerate(order):
        if p_values[index] > level / (m - rank):
            break
        passed[index] = True
    return passed


def benjamini_hochberg(p_values: Floats, level: float) -> NDArray[np.bool_]:
    """Benjamini and Hochberg's step-up: false discovery rate `level`, shape (m,)."""
    m = p_values.size
    order = np.argsort(p_values)
    under = p_values[order] <= level * np.arange(1, m + 1) / m
    passed = np.zeros(m, dtype=bool)
    if under.any():
        passed[order[: int(np.flatnonzero(under).max()) + 1]] = True
    return passed
