"""What a log is asked for, once a delay of the encoders is taken out: its laws, coordinates without one, and the noise beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.laws import Frame, Law, candidate_laws, constant_laws, frame_of, strangers
from gyrocal.diagnosis.drive.series import NODE_S, DriveSeries, nodes_of, rough_bias_dps
from gyrocal.diagnosis.drive.yaw import NoiseSearch, noise_search

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Asked:
    """The heading difference of a log, and what may be in it.

    Attributes
    ----------
    ahead_s, window_s : delay and window of the encoders that are taken out
    constant, laws : those of every log, and those that a log may hold
    blocks : columns of each coordinate, for what has no name
    candidates : of `laws` those that it is asked for
    noise : with all laws free in the mean
    """

    series: DriveSeries
    ahead_s: float
    window_s: float
    frame: Frame
    constant: Mapping[str, Law]
    laws: Mapping[str, Law]
    blocks: Mapping[str, Floats]
    candidates: Sequence[str]
    noise: NoiseSearch

    @classmethod
    def of(cls, series: DriveSeries, ahead_s: float, window_s: float) -> Self:
        """All that a log may be asked for at a delay and a window of its encoders."""
        nodes = nodes_of(series, max(NODE_S, window_s))
        frame = frame_of(series, nodes, ahead_s, window_s, rough_bias_dps(series))
        constant, laws, blocks = constant_laws(frame), candidate_laws(frame), strangers(frame)
        noise = noise_search(frame, [x.column for x in (constant | laws).values()])
        return cls(series, ahead_s, window_s, frame, constant, laws, blocks, list(laws), noise)

    def beside(self, columns: Sequence[Floats], candidates: Sequence[str]) -> Self:
        """The same, asked for some of the laws, with noise beside more columns."""
        means = [x.column for x in (*self.constant.values(), *self.laws.values())]
        return replace(self, candidates=candidates, noise=noise_search(self.frame, [*means, *columns]))
