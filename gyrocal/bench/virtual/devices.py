"""Virtual devices in this process: thin handles on the one `World`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrocal.bench.clock import VirtualClock
from gyrocal.bench.devices import (
    Bench,
    ChamberLimits,
    ChamberReading,
    GyroSamples,
    StreamHealth,
    TableLimits,
    TableReading,
)
from gyrocal.bench.profile import Profile, VirtualSpec
from gyrocal.bench.virtual.world import World, WorldSpec
from gyrocal.physics.gyro import GyroModel, rd2100_unit


class VirtualGyro:
    """The gyro of a `World`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._frames = 0

    def start(self) -> None:
        """Forget what came before."""
        self._world.take_gyro()

    def drain(self) -> GyroSamples:
        """All samples since the last call."""
        samples = self._world.take_gyro()
        self._frames += samples.t_s.size
        return samples

    def health(self) -> StreamHealth:
        """Every frame is good."""
        return StreamHealth(frames_good=self._frames)

    def close(self) -> None:
        """Nothing to close."""


class VirtualTable:
    """The table of a `World`."""

    def __init__(self, world: World) -> None:
        self._world = world

    def limits(self) -> TableLimits:
        """Limits of the virtual table."""
        spec = self._world.spec.table
        return TableLimits(spec.max_rate_dps, spec.max_acceleration_dps2)

    def start(self) -> None:
        """Ready at once."""

    def set_rate(self, rate_dps: float) -> float:
        """Command a rate; raises DeviceError beyond the table's own limit."""
        return self._world.command_rate(rate_dps)

    def read(self) -> TableReading:
        """What the encoder says."""
        rate_dps, angle_deg = self._world.read_table()
        return TableReading(self._world.now_s, rate_dps, angle_deg)

    def faults(self) -> tuple[str, ...]:
        """None."""
        return ()

    def send_stop(self) -> None:
        """Bring the table to rest."""
        self._world.command_rate(0.0)

    def close(self) -> None:
        """Nothing to close."""


class VirtualChamber:
    """The chamber of a `World`."""

    def __init__(self, world: World) -> None:
        self._world = world

    def limits(self) -> ChamberLimits:
        """Limits of the virtual chamber."""
        spec = self._world.spec.chamber
        return ChamberLimits(spec.min_temp_c, spec.max_temp_c, spec.max_ramp_c_per_min)

    def start(self) -> None:
        """Ready at once."""

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """The virtual chamber keeps its set points and needs no alarm."""

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Command a set point; raises DeviceError beyond the chamber's own limits."""
        self._world.command_temperature(temp_c, ramp_c_per_min)

    def read(self) -> ChamberReading:
        """Air and set point."""
        temp_c, setpoint_c = self._world.read_chamber()
        return ChamberReading(self._world.now_s, temp_c, setpoint_c, running=True)

    def close(self) -> None:
        """Nothing to close; the set point stays."""


class VirtualSupply:
    """The supply of a `World`."""

    def __init__(self, world: World) -> None:
        self._world = world

    def read_v(self) -> float:
        """Volts at the gyro."""
        return self._world.read_supply()


def gyro_of(spec: VirtualSpec, sample_rate_hz: float) -> GyroModel:
    """The unit that a profile's ``[virtual]`` draws, with the changes it asks for."""
    changes = {name: value for name, value in vars(spec.gyro).items() if value is not None}
    return replace(rd2100_unit(spec.unit_seed), sample_rate_hz=sample_rate_hz, **changes)


def virtual_bench(
    profile: Profile, *, start_s: float = 0.0, restarts: int = 0
) -> tuple[Bench, VirtualClock, World]:
    """The bench of a profile's ``[virtual]``, everything at rest at its start temperature, on its own clock.

    Parameters
    ----------
    start_s : float
        Time at which the clock starts; later than 0 when a run is carried on.
    restarts : int
        How often the run was carried on before: each start has noise of its own.
    """
    spec = profile.virtual
    world = World(
        WorldSpec(
            gyro=gyro_of(spec, profile.sensor.sample_rate_hz),
            table=spec.table,
            chamber=spec.chamber,
            supply=spec.supply,
            effects=spec.effects,
            start_temp_c=spec.start_temp_c,
            power_on_t_s=-(profile.sensor.on_before_s or 0.0),
        ),
        np.random.default_rng([spec.seed, restarts]),
        start_s,
    )
    clock = VirtualClock(start_s)
    clock.subscribe(world.advance_to)
    bench = Bench(
        VirtualGyro(world), VirtualTable(world), VirtualChamber(world), VirtualSupply(world), "virtual"
    )
    return bench, clock, world
