"""Gains of columns beside others, from the Gram matrix of all of them.

Whitened noise is white and Gaussian, so a block of columns that explains nothing gains a chi-square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def project(gram: Floats, model: Ints) -> Projection:
    """Project a model out of a Gram matrix whose row 0 is the record.

    Parameters
    ----------
    gram : ndarray, shape (1 + p, 1 + p)
    model : ndarray of int
        Column numbers (from 0, the record not counted); may be collinear.
    """
    norm = np.diag(gram).copy()
    cross = gram[model + 1]
    inner = cross[:, model + 1]
    if cross.size:
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        values, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
        kept = values > 1e-10 * values[-1]
        half = (vectors[:, kept] / np.sqrt(values[kept])).T @ (cross / scale[:, None])
        gram = gram - half.T @ half
    return Projection(gram[1:, 1:], gram[1:, 0].copy(), norm[1:], float(gram[0, 0]))
