"""What the runner asks of a gyro, a rate table and a chamber. Real and virtual ones are interchangeable."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def _no_samples() -> Floats:
    return np.empty(0)


@dataclass(frozen=True)
class GyroSamples:
    """Samples since the last call, arrays of shape (n,): s since the run began, deg/s, deg C (NaN: none), 0 is good."""

    t_s: Floats = field(default_factory=_no_samples)
    gyro_dps: Floats = field(default_factory=_no_samples)
    gyro_temp_c: Floats = field(default_factory=_no_samples)
    status: Floats = field(default_factory=_no_samples)


@dataclass(frozen=True)
class StreamHealth:
    """Counters of a gyro's stream since it was opened; `in_sequence` frames followed the one before by the device's own."""

    bytes_in: int = 0
    bytes_skipped: int = 0
    frames_good: int = 0
    frames_bad: int = 0
    sequence_gaps: int = 0
    status_bad: int = 0
    restarts: int = 0
    in_sequence: int = 0

    def since(self, before: StreamHealth) -> StreamHealth:
        """What was counted since `before`."""
        return StreamHealth(*(getattr(self, f.name) - getattr(before, f.name) for f in fields(self)))


@dataclass(frozen=True)
class TableReading:
    """Measured rate and unwrapped angle of the table, with the time of the reading, which may be off by `unsure_s`."""

    t_s: float
    rate_dps: float
    angle_deg: float
    unsure_s: float = 0.0

    @classmethod
    def between(cls, asked_s: float, answered_s: float, rate_dps: float, angle_deg: float) -> TableReading:
        """A reading taken at some time between question and answer."""
        middle_s, half_s = 0.5 * (asked_s + answered_s), 0.5 * (answered_s - asked_s)
        return cls(middle_s, rate_dps, angle_deg, half_s)


@dataclass(frozen=True)
class TableLimits:
    """What the table can do."""

    max_rate_dps: float
    max_acceleration_dps2: float


@dataclass(frozen=True)
class ChamberReading:
    """Measured air temperature and set point of the chamber; `alarms` in the chamber's own words.

    `plate_c` is that of the plate under the gyro, where the chamber has a probe there; else NaN.
    """

    t_s: float
    temp_c: float
    setpoint_c: float
    running: bool
    alarms: tuple[str, ...] = ()
    plate_c: float = math.nan


@dataclass(frozen=True)
class ChamberLimits:
    """Set points that the chamber accepts, and how fast it can go."""

    min_temp_c: float
    max_temp_c: float
    max_ramp_c_per_min: float


class Gyro(Protocol):
    """A gyro that streams. Reading never waits for disk, table or chamber."""

    def start(self) -> None:
        """Open the stream; raises DeviceError when nothing, or nothing readable, comes."""
        ...

    def drain(self) -> GyroSamples:
        """All samples that came since the last call; raises DeviceError when the stream is gone."""
        ...

    def health(self) -> StreamHealth:
        """Counters since `start`."""
        ...

    def close(self) -> None:
        """Close; never raises."""
        ...


class RateTable(Protocol):
    """A rotary table that turns at a constant rate."""

    def limits(self) -> TableLimits:
        """Limits of the table itself."""
        ...

    def start(self) -> None:
        """Connect and make ready; does not move."""
        ...

    def set_rate(self, rate_dps: float) -> float:
        """Command a rate; returns the rate that the controller can really make."""
        ...

    def read(self) -> TableReading:
        """Measured rate and angle."""
        ...

    def faults(self) -> tuple[str, ...]:
        """Faults in the controller's own words; empty is good."""
        ...

    def send_stop(self) -> None:
        """Send one complete stop command without waiting for any reply."""
        ...

    def close(self) -> None:
        """Close; never raises, never moves."""
        ...


class Chamber(Protocol):
    """A thermal chamber with a set point."""

    def limits(self) -> ChamberLimits:
        """Limits of the chamber itself."""
        ...

    def start(self) -> None:
        """Connect and switch on."""
        ...

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Program the chamber's own alarms, which protect the gyro when the PC is dead."""
        ...

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Command a set point, verified by read-back."""
        ...

    def read(self) -> ChamberReading:
        """Measured temperature, set point, state and alarms."""
        ...

    def close(self) -> None:
        """Close; never raises. The chamber keeps its set point."""
        ...


class Supply(Protocol):
    """The gyro's supply; many benches have none that can be read."""

    def read_v(self) -> float:
        """Volts at the gyro, NaN where not measured."""
        ...


class NoSupply:
    """A supply that nobody measures."""

    def read_v(self) -> float:
        """NaN."""
        return float("nan")


@dataclass(frozen=True)
class Bench:
    """The devices of a bench. `describe` is what the run directory and the journal say about them."""

    gyro: Gyro
    table: RateTable
    chamber: Chamber
    supply: Supply = field(default_factory=NoSupply)
    describe: str = "real"
