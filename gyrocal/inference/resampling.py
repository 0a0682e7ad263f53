"""Means of what was left out, drawn again in whole blocks: neighbours have errors in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def block_means(
    values: Sequence[Floats], block: NDArray[np.int64], draws: int, rng: np.random.Generator
) -> Floats:
    """Means of values over blocks that are drawn with replacement, shape (number of values, draws).

    Parameters
    ----------
    values : each of shape (n,)
    block : ndarray, shape (n,)
        Number of the block that each belongs to.

    References
    ----------
    Kuensch, Ann. Stat. 17 (1989), 1217-1241.
    """
    number = np.unique(block, return_inverse=True)[1]
    sums = np.stack([np.bincount(number, x) for x in (np.ones(number.size), *values)])
    drawn = sums[:, rng.integers(0, sums.shape[1], (draws, sums.shape[1]))].sum(axis=2)
    return np.asarray(drawn[1:] / drawn[0])
