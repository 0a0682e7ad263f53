"""Long logs at one rate: neighbouring rows averaged to data sets of workable number."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import DataSets

Floats = NDArray[np.float64]


def coarsen(sets: DataSets, most: int) -> tuple[DataSets, int]:
    """At most about `most` data sets, each the mean of rows in a row at the same rate.

    Returns
    -------
    sets : DataSets
        Their ``gyro_std_dps`` and ``n`` describe the rows of a block; ids are those of its first row.
    block : int
        Rows in a block; 1 leaves everything as it is.
    """
    block = -(-len(sets) // most)
    if block == 1:
        return sets, 1
    change = np.flatnonzero(np.diff(sets.rate_dps) != 0) + 1
    starts = np.concatenate(
        [np.arange(part[0], part[-1] + 1, block) for part in np.split(np.arange(len(sets)), change)]
    )
    size = np.diff(np.append(starts, len(sets)))

    def mean(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(values, starts) / size)

    gyro = mean(sets.gyro_dps)
    squares = np.add.reduceat((sets.gyro_dps - np.repeat(gyro, size)) ** 2, starts)
    picked = {f.name: getattr(sets, f.name)[starts] for f in fields(sets)}
    means = {name: mean(getattr(sets, name)) for name in ("rate_dps", "temp_c", "t_s", "temp_rate_c_per_min")}
    span = np.maximum.reduceat(sets.t_s, starts) - np.minimum.reduceat(sets.t_s, starts)
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.where(size > 1, np.sqrt(squares / np.maximum(size - 1, 1)), np.nan)
        duration = span * size / np.maximum(size - 1, 1)
    extra = {"gyro_dps": gyro, "gyro_std_dps": std, "n": size.astype(np.float64), "duration_s": duration}
    peaks = {"gyro_peak_dps": np.full(starts.size, np.nan)}
    return replace(sets, **(picked | means | extra | peaks)), block
