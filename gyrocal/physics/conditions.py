"""What an effect may depend on, sample by sample, and what it remembers from block to block."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.units import DEG_TO_RAD

Floats = NDArray[np.float64]

#: What an effect remembers between blocks of samples (low-passed temperature, play positions, ...).
Memory = Any


@dataclass(frozen=True)
class Conditions:
    """What an effect may depend on, sample by sample, in time order. None: that channel is not known.

    Every array has shape (n,).

    Attributes
    ----------
    t_s : s since the record began
    rate_dps : true rate (on the bench the table's), deg/s
    temp_c : gyro temperature as reported, deg C; NaN where it was not reported
    dt_s : averaging time of a sample, s
    angle_deg : table angle, deg
    supply_v : supply, V
    since_power_on_s : s since the gyro was switched on
    since_step_s, step_dps : s since the last change of rate, and its size, deg/s
    gyro_dps : the output before this effect, deg/s; given by whoever injects an effect, never by
        whoever analyses (the recorded output has the effect in it already)
    command_dps : commanded rate, where it differs from `rate_dps`, deg/s
    temp_rate_c_per_s : temperature rate, where it is known; otherwise the effects derive it from what went before
    data_set_index : number of the data set in the record
    row_s : averaging time of each row, where rows are means over a while, s
    sample_std_dps : white noise of the samples that such rows are means of, deg/s; 0: not known
    """

    t_s: Floats
    rate_dps: Floats
    temp_c: Floats
    dt_s: float | None = None
    angle_deg: Floats | None = None
    supply_v: Floats | None = None
    since_power_on_s: Floats | None = None
    since_step_s: Floats | None = None
    step_dps: Floats | None = None
    gyro_dps: Floats | None = None
    command_dps: Floats | None = None
    temp_rate_c_per_s: Floats | None = None
    data_set_index: Floats | None = None
    row_s: Floats | None = None
    sample_std_dps: float = 0.0

    def __len__(self) -> int:
        return int(self.t_s.size)

    def cut(self, rows: slice) -> Conditions:
        """The same, for some of the rows."""
        arrays: dict[str, Any] = {
            f.name: v[rows] for f in fields(self) if isinstance(v := getattr(self, f.name), np.ndarray)
        }
        return replace(self, **arrays)

    def need(self, channel: str) -> Floats:
        """An optional channel that a law cannot do without.

        Raises
        ------
        DataError
            The record has no such channel.
        """
        values: Floats | None = getattr(self, channel)
        if values is None:
            raise DataError(f"The effect depends on {channel}, and this record does not have it.")
        return values

    def since(self, at_s: float) -> Floats:
        """Share of each row that is behind an instant."""
        if self.row_s is None:
            return np.asarray(self.t_s >= at_s, dtype=np.float64)
        return np.asarray(np.clip((self.t_s - at_s) / self.row_s + 0.5, 0.0, 1.0))

    def turned(self, harmonic: float, phase_rad: float) -> Floats:
        """Cosine of so many periods a turn of the table plus a phase, as the mean over what each row turned."""
        turns = 0.0 if self.row_s is None else self.rate_dps * self.row_s / 360.0
        angle_rad = DEG_TO_RAD * self.need("angle_deg")
        return np.asarray(np.sinc(harmonic * turns) * np.cos(harmonic * angle_rad + phase_rad))
