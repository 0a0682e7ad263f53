"""One physical world: table, chamber, supply and gyro, advanced together in whole samples of the gyro."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import copysign, exp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.bench.devices import GyroSamples
from gyrocal.bench.profile import VirtualChamberSpec, VirtualSupplySpec, VirtualTableSpec
from gyrocal.errors import DeviceError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.gyro import GyroModel, GyroStream
from gyrocal.units import S_PER_MIN

Floats = NDArray[np.float64]

#: Correlation time of the servo's wobble, s.
_WOBBLE_S = 0.1


@dataclass(frozen=True)
class WorldSpec:
    """What the world is made of; `effects` by id, each with all its parameters."""

    gyro: GyroModel
    table: VirtualTableSpec
    chamber: VirtualChamberSpec
    supply: VirtualSupplySpec
    effects: Mapping[str, Mapping[str, float]]
    start_temp_c: float
    power_on_t_s: float


class World:
    """The virtual bench's physics. Commands act from now on; `advance_to` lets time pass.

    Nothing in here knows a clock: the virtual clock drives it at once, a wire server in real time.
    """

    def __init__(self, spec: WorldSpec, rng: np.random.Generator, start_s: float = 0.0) -> None:
        self.spec = spec
        self._dt_s = 1.0 / spec.gyro.sample_rate_hz
        self._start_s = start_s
        self._samples = 0
        gyro_rng, self._table_rng, self._read_rng = rng.spawn(3)
        self._stream = GyroStream(spec.gyro, gyro_rng)
        # table, in the encoder's eyes
        self._rate_dps = 0.0
        self._target_dps = 0.0
        self._angle_deg = 0.0
        self._wobble_deg = 0.0
        self._reference_error = 0.0
        self._step_t_s = start_s
        self._step_dps = 0.0
        self._before_deg = 0.0
        # chamber
        self._target_c = self._set_c = self._still_air_c = self._air_c = self._case_c = spec.start_temp_c
        self._ramp_c_per_s = spec.chamber.max_ramp_c_per_min / S_PER_MIN
        # what the gyro has still to see: angles and case temperatures (with the one before), commands by block
        self._memory: dict[str, Memory] = {}
        self._angles_deg = [0.0]
        self._cases_c = [self._case_c]
        self._commands: list[tuple[int, float, float, float, float]] = []

    @property
    def now_s(self) -> float:
        """Time of the last whole sample."""
        return self._start_s + self._samples * self._dt_s

    # commands

    def command_rate(self, rate_dps: float) -> float:
        """Turn the table to a rate; returns what the controller can make."""
        table = self.spec.table
        if not abs(rate_dps) <= table.max_rate_dps:
            msg = f"The virtual table refuses {rate_dps:g} deg/s: it can do {table.max_rate_dps:g} deg/s at most."
            raise DeviceError(msg)
        target = round(rate_dps, 6)
        if target != self._target_dps:
            self._step_dps = target - self._rate_dps
            self._step_t_s = self.now_s + abs(self._step_dps) / table.max_acceleration_dps2
            self._reference_error = float(self._table_rng.normal(0.0, table.rate_error_ppm * 1e-6))
        self._target_dps = target
        return target

    def command_temperature(self, temp_c: float, ramp_c_per_min: float | None) -> None:
        """Take the chamber to a set point."""
        chamber = self.spec.chamber
        if not chamber.min_temp_c <= temp_c <= chamber.max_temp_c:
            msg = (
                f"The virtual chamber refuses {temp_c:g} °C: its set points go from {chamber.min_temp_c:g} to "
                f"{chamber.max_temp_c:g} °C."
            )
            raise DeviceError(msg)
        ramp = chamber.max_ramp_c_per_min if ramp_c_per_min is None else ramp_c_per_min
        self._ramp_c_per_s = min(ramp, chamber.max_ramp_c_per_min) / S_PER_MIN
        self._target_c = temp_c

    # readings

    def read_table(self) -> tuple[float, float]:
        """Rate over the last sample and unwrapped angle, as the encoder resolves them."""
        step = self.spec.table.encoder_step_deg
        before, now = (round(angle / step) for angle in (self._before_deg, self._angles_deg[-1]))
        return round((now - before) * step / self._dt_s, 9), round(now * step, 9)

    def read_chamber(self) -> tuple[float, float]:
        """Air temperature and set point."""
        noise = self.spec.chamber.noise_c * self._read_rng.standard_normal()
        return self._air_c + noise, self._target_c

    def read_supply(self) -> float:
        """Volts at the gyro, to a millivolt."""
        volts = self._supply_v(abs(self._rate_dps), self._compressor_on(self.now_s))
        return round(float(volts + self.spec.supply.noise_v * self._read_rng.standard_normal()), 3)

    def take_gyro(self) -> GyroSamples:
        """The gyro's samples since the last call; only now are they worked out, in one block."""
        if not self._commands:
            return GyroSamples()
        c = self._conditions()
        gyro_dps = self._stream.analogue(self._dt_s, c.rate_dps, c.temp_c)
        for effect_id in self._acting_on("gyro"):
            gyro_dps = gyro_dps + self._error_dps(effect_id, c, gyro_dps)
        converter = self._acting_on("converter")
        for effect_id in converter:
            gyro_dps = gyro_dps + self._error_dps(effect_id, c, gyro_dps)
        if not converter:
            gyro_dps = self._stream.digitise(self._dt_s, gyro_dps)
        return GyroSamples(c.t_s, gyro_dps, self._stream.temperatures(c.temp_c), np.zeros(len(c)))

    # time

    def advance_to(self, now_s: float) -> None:
        """Let time pass up to `now_s`, in whole samples.

        A scalar loop: between two readings lie a handful of samples, too few for arrays to pay.
        """
        n = int(np.floor((now_s - self._start_s) / self._dt_s + 1e-6)) - self._samples
        if n <= 0:
            return
        self._advance_chamber(n)
        self._advance_table(n)
        self._samples += n
        self._commands.append((n, self._target_dps, self._reference_error, self._step_t_s, self._step_dps))

    def _advance_table(self, n: int) -> None:
        """Speed up or slow down at the table's acceleration; a braked table stands still, a turning one wobbles."""
        table, dt_s = self.spec.table, self._dt_s
        spin_dps = table.max_acceleration_dps2 * dt_s
        decay = float(np.exp(-dt_s / _WOBBLE_S))
        push_deg = table.wobble_deg * float(np.sqrt(1.0 - decay**2))
        rate_dps, angle_deg, wobble_deg = self._rate_dps, self._angle_deg, self._wobble_deg
        for draw in self._table_rng.standard_normal(n).tolist():
            change = self._target_dps - rate_dps
            after_dps = self._target_dps if abs(change) <= spin_dps else rate_dps + copysign(spin_dps, change)
            angle_deg += (rate_dps + after_dps) / 2.0 * dt_s
            rate_dps = after_dps
            wobble_deg = decay * wobble_deg + push_deg * draw if rate_dps else 0.0
            self._before_deg = self._angles_deg[-1]
            self._angles_deg.append(angle_deg + wobble_deg)
        self._rate_dps, self._angle_deg, self._wobble_deg = rate_dps, angle_deg, wobble_deg

    def _advance_chamber(self, n: int) -> None:
        """Set point on its ramp, air behind the set point, compressor ripple on the air, case behind the air."""
        chamber, dt_s = self.spec.chamber, self._dt_s
        step_c = self._ramp_c_per_s * dt_s
        to_air, to_case = 1.0 - exp(-dt_s / chamber.air_s), 1.0 - exp(-dt_s / chamber.case_s)
        set_c, still_c, case_c = self._set_c, self._still_air_c, self._case_c
        for k in range(self._samples + 1, self._samples + n + 1):
            change = self._target_c - set_c
            set_c = self._target_c if abs(change) <= step_c else set_c + copysign(step_c, change)
            still_c += to_air * (set_c - still_c)
            phase = (self._start_s + k * dt_s) / chamber.ripple_period_s % 1.0
            self._air_c = still_c + chamber.ripple_c * (4.0 * abs(phase - 0.5) - 1.0)
            case_c += to_case * (self._air_c - case_c)
            self._cases_c.append(case_c)
        self._set_c, self._still_air_c, self._case_c = set_c, still_c, case_c

    def _conditions(self) -> Conditions:
        """Everything since the last call, in the encoder's eyes; clears what was kept for it."""
        lengths, target, reference, step_t, step = (
            np.array(column) for column in zip(*self._commands, strict=True)
        )
        n = int(lengths.sum())
        angle_deg, cases_c = np.array(self._angles_deg), np.array(self._cases_c)
        t_s: Floats = self._start_s + self._dt_s * np.arange(
            self._samples - n + 1, self._samples + 1, dtype=np.float64
        )
        encoder_dps = np.diff(angle_deg) / self._dt_s
        c = Conditions(
            t_s=t_s,
            rate_dps=encoder_dps,
            temp_c=cases_c[1:],
            dt_s=self._dt_s,
            angle_deg=angle_deg[1:],
            supply_v=self._supply_v(np.abs(encoder_dps), self._compressor_on(t_s)),
            since_power_on_s=t_s - self.spec.power_on_t_s,
            since_step_s=t_s - np.repeat(step_t, lengths),
            step_dps=np.repeat(step, lengths),
            command_dps=np.repeat(target, lengths),
            temp_rate_c_per_s=np.diff(cases_c) / self._dt_s,
        )
        true_dps = encoder_dps * (1.0 + np.repeat(reference, lengths))
        for effect_id in self._acting_on("reference"):
            true_dps = true_dps + self._error_dps(effect_id, c, encoder_dps)
        self._commands, self._cases_c, self._angles_deg = [], self._cases_c[-1:], self._angles_deg[-1:]
        return replace(c, rate_dps=true_dps)

    def _compressor_on(self, t_s: Any) -> Any:
        """The compressor runs while the air falls: the first half of each period. Scalar or array."""
        return t_s / self.spec.chamber.ripple_period_s % 1.0 < 0.5

    def _supply_v(self, speed_dps: Any, compressor_on: Any) -> Any:
        supply = self.spec.supply
        return supply.nominal_v - supply.sag_v * speed_dps / 100.0 - supply.compressor_v * compressor_on

    def _acting_on(self, part: str) -> list[str]:
        return [e for e in self.spec.effects if CATALOGUE[e].acts_on == part]

    def _error_dps(self, effect_id: str, c: Conditions, gyro_dps: Floats) -> Floats:
        given = replace(c, gyro_dps=gyro_dps)
        error, self._memory[effect_id] = CATALOGUE[effect_id].error_dps(
            given, self.spec.effects[effect_id], self.spec.gyro.surface, self._memory.get(effect_id)
        )
        return error
