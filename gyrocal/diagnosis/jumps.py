"""Where the bias may have jumped: every instant of a record at once.

A jump is sharp: misplaced by half a minute it loses most of its gain, and a net of instants fine enough would be
thousands of columns. The score of a jump before row i is the sum, from row i on, of the residual times the inverse
covariance, so one pass back through the noise filter gives the scores of all rows; the same pass over draws of the
noise gives their variances and the null of the largest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.series import Series
from gyrocal.diagnosis.whitening import NoiseLevels, NoiseModel

Floats = NDArray[np.float64]

_DRAWS = 300
#: Rows at either end at which no jump is looked for: it would be an offset of the rest.
_EDGE_ROWS = 3
#: Jumps nearer to one another are one candidate, s.
_APART_S = 60.0


@dataclass(frozen=True)
class Scan:
    """Gains of a jump before each row but the first.

    Attributes
    ----------
    at_s : ndarray, shape (n - 1,)
        Instants between one row and the next.
    gains : ndarray, shape (n - 1,)
        Approximate drop of the residual sum of squares.
    trials : float
        Independent trials that the largest of them is worth.
    """

    at_s: Floats
    gains: Floats
    trials: float

    def candidates(self, count: int, around: int) -> Floats:
        """Instants of the highest peaks, each with so many instants on either side."""
        gains = self.gains.copy()
        found = []
        for _ in range(count):
            top = int(np.argmax(gains))
            if gains[top] <= 0.0:
                break
            found.append(self.at_s[max(top - around, 0) : top + around + 1])
            gains[np.abs(self.at_s - self.at_s[top]) < _APART_S] = 0.0
        return np.unique(np.concatenate(found)) if found else np.empty(0)


def scan(
    series: Series, model: NoiseModel, levels: NoiseLevels, y: Floats, X: Floats, rng: np.random.Generator
) -> Scan:
    """Scan a record for jumps of the bias, given the columns of a model.

    Parameters
    ----------
    y : ndarray, shape (n,)
    X : ndarray, shape (n, p)
    """
    white = model.whiten(levels, np.column_stack([y, X]))[0]
    norms = np.linalg.norm(white[:, 1:], axis=0)
    left, values, _ = np.linalg.svd(white[:, 1:] / np.where(norms > 0, norms, 1.0), full_matrices=False)
    q = left[:, values > 1e-9 * values[0]]
    rows = np.column_stack([white[:, 0], rng.standard_normal((y.size, _DRAWS))])
    rows -= q @ (q.T @ rows)
    scores = np.cumsum(model.adjoint(levels, rows)[::-1], axis=0)[::-1][1:]
    variance = np.mean(scores[:, 1:] ** 2, axis=1)
    usable = variance > 1e-6 * float(np.median(variance))
    usable[:_EDGE_ROWS] = usable[-_EDGE_ROWS:] = False
    gains = np.where(usable[:, None], scores**2, 0.0) / np.where(usable, variance, 1.0)[:, None]
    threshold = float(np.quantile(gains[:, 1:].max(axis=0), 0.95))
    ends = series.t_s + 0.5 * series.averaging_s
    starts = series.t_s - 0.5 * series.averaging_s
    return Scan(0.5 * (ends[:-1] + starts[1:]), gains[:, 0], max(1.0, 0.05 / float(chi2.sf(threshold, 1))))
