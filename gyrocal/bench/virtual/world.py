"""One physical world: table, chamber, supply and gyro, advanced together in whole samples of the gyro."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from gyrocal.bench.devices import GyroSamples
from gyrocal.bench.profile import VirtualChamberSpec, VirtualSupplySpec, VirtualTableSpec
from gyrocal.errors import DeviceError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Conditions, Memory
from gyrocal.physics.gyro import GyroModel, GyroStream
from gyrocal.physics.kernels import LagMemory, lag
from gyrocal.units import S_PER_MIN

Floats = NDArray[np.float64]

#: Effects of the reference: the servo follows its encoder, so the true rate bears the error.
_OF_THE_REFERENCE = ("table_eccentricity", "reference_rate_error")
#: Effects of the converter: they act on the output, last, and take the place of the unit's own bits.
_OF_THE_CONVERTER = ("truncation", "quantisation")

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
        self._encoder = (0.0, 0.0)
        # chamber
        self._set_c = spec.start_temp_c
        self._target_c = spec.start_temp_c
        self._ramp_c_per_s = spec.chamber.max_ramp_c_per_min / S_PER_MIN
        self._air_memory: LagMemory | None = None
        self._case_memory: LagMemory | None = None
        self._air_c = spec.start_temp_c
        # gyro
        self._memory: dict[str, Memory] = {}
        self._waiting: list[Conditions] = []

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
        """Rate and unwrapped angle as the encoder resolves them."""
        return self._encoder

    def read_chamber(self) -> tuple[float, float]:
        """Air temperature and set point."""
        noise = self.spec.chamber.noise_c * self._read_rng.standard_normal()
        return self._air_c + noise, self._target_c

    def read_supply(self) -> float:
        """Volts at the gyro, to a millivolt."""
        on = self._compressor_on(np.array([self.now_s]))
        volts = self._supply_v(np.array([self._rate_dps]), on)[0]
        return round(float(volts + self.spec.supply.noise_v * self._read_rng.standard_normal()), 3)

    def take_gyro(self) -> GyroSamples:
        """The gyro's samples since the last call; only now are they worked out, in one block."""
        if not self._waiting:
            return GyroSamples()
        c = _joined(self._waiting)
        self._waiting = []
        gyro_dps = self._stream.analogue(self._dt_s, c.rate_dps, c.temp_c)
        for effect_id in self.spec.effects:
            if effect_id not in _OF_THE_REFERENCE + _OF_THE_CONVERTER:
                gyro_dps = gyro_dps + self._error_dps(effect_id, c, gyro_dps)
        converter = [e for e in self.spec.effects if e in _OF_THE_CONVERTER]
        for effect_id in converter:
            gyro_dps = gyro_dps + self._error_dps(effect_id, c, gyro_dps)
        if not converter:
            gyro_dps = self._stream.digitise(self._dt_s, gyro_dps)
        return GyroSamples(c.t_s, gyro_dps, self._stream.temperatures(c.temp_c), np.zeros(len(c)))

    # time

    def advance_to(self, now_s: float) -> None:
        """Let time pass up to `now_s`, in whole samples."""
        n = int(np.floor((now_s - self._start_s) / self._dt_s + 1e-6)) - self._samples
        if n <= 0:
            return
        t_s: Floats = self._start_s + self._dt_s * np.arange(
            self._samples + 1, self._samples + n + 1, dtype=np.float64
        )
        self._samples += n
        case_c = self._advance_chamber(t_s)
        rate_dps, angle_deg = self._advance_table(t_s)
        self._waiting.append(
            Conditions(
                t_s=t_s,
                rate_dps=rate_dps,
                temp_c=case_c,
                dt_s=self._dt_s,
                angle_deg=angle_deg,
                supply_v=self._supply_v(rate_dps, self._compressor_on(t_s)),
                since_power_on_s=t_s - self.spec.power_on_t_s,
                since_step_s=t_s - self._step_t_s,
                step_dps=np.full(n, self._step_dps),
                command_dps=np.full(n, self._target_dps),
            )
        )

    def _advance_table(self, t_s: Floats) -> tuple[Floats, Floats]:
        """True mean rate over each sample and angle at its end."""
        table, n = self.spec.table, t_s.size
        after_s = self._dt_s * np.arange(n + 1)
        change = self._target_dps - self._rate_dps
        spin_s = np.minimum(after_s, abs(change) / table.max_acceleration_dps2)
        acceleration = np.copysign(table.max_acceleration_dps2, change)
        rate_dps = self._rate_dps + acceleration * spin_s if change else np.full(n + 1, self._rate_dps)
        turned = (self._rate_dps + rate_dps) / 2 * spin_s + self._target_dps * (after_s - spin_s)
        moving = rate_dps[1:] != 0.0
        wobble_deg = self._advance_wobble(n) * moving
        angle_deg = self._angle_deg + turned[1:] + wobble_deg
        before_deg = np.concatenate(([self._encoder_deg()], angle_deg[:-1]))
        encoder_dps = (angle_deg - before_deg) / self._dt_s
        self._angle_deg += float(turned[-1])
        self._rate_dps = float(rate_dps[-1]) if spin_s[-1] == after_s[-1] else self._target_dps
        self._wobble_deg = float(wobble_deg[-1])
        step = table.encoder_step_deg
        self._encoder = (
            round(round(float(encoder_dps[-1]) * self._dt_s / step) * step / self._dt_s, 9),
            round(round(float(angle_deg[-1]) / step) * step, 9),
        )
        c = Conditions(
            t_s,
            encoder_dps,
            np.full(n, np.nan),
            angle_deg=angle_deg,
            command_dps=np.full(n, self._target_dps),
        )
        true_dps = encoder_dps * (1.0 + self._reference_error)
        for effect_id in self.spec.effects:
            if effect_id in _OF_THE_REFERENCE:
                true_dps = true_dps + self._error_dps(effect_id, c, encoder_dps)
        return true_dps, angle_deg

    def _encoder_deg(self) -> float:
        return self._angle_deg + self._wobble_deg

    def _advance_wobble(self, n: int) -> Floats:
        """Position error of the servo: first-order noise, kept within bounds by its loop."""
        decay = float(np.exp(-self._dt_s / _WOBBLE_S))
        drive = (
            self.spec.table.wobble_deg * np.sqrt(1.0 - decay**2) * self._table_rng.standard_normal(n)
        ).tolist()
        path = list(accumulate(drive, lambda last, push: decay * last + push, initial=self._wobble_deg))
        return np.array(path[1:])

    def _advance_chamber(self, t_s: Floats) -> Floats:
        """Temperature of the gyro's case at the end of each sample."""
        chamber = self.spec.chamber
        change = self._target_c - self._set_c
        after_s = self._dt_s * np.arange(1, t_s.size + 1)
        set_c = self._set_c + np.copysign(np.minimum(self._ramp_c_per_s * after_s, abs(change)), change)
        self._set_c = float(set_c[-1])
        behind_c, self._air_memory = lag(t_s, set_c, chamber.air_s, self._air_memory)
        phase = t_s / chamber.ripple_period_s % 1.0
        air_c = set_c - behind_c + chamber.ripple_c * (4.0 * np.abs(phase - 0.5) - 1.0)
        self._air_c = float(air_c[-1])
        behind_c, self._case_memory = lag(t_s, air_c, chamber.case_s, self._case_memory)
        return np.asarray(air_c - behind_c)

    def _compressor_on(self, t_s: Floats) -> NDArray[np.bool_]:
        """The compressor runs while the air falls: the first half of each period."""
        return np.asarray(t_s / self.spec.chamber.ripple_period_s % 1.0 < 0.5)

    def _supply_v(self, rate_dps: Floats, compressor_on: NDArray[np.bool_]) -> Floats:
        supply = self.spec.supply
        return np.asarray(
            supply.nominal_v - supply.sag_v * np.abs(rate_dps) / 100.0 - supply.compressor_v * compressor_on
        )

    def _error_dps(self, effect_id: str, c: Conditions, gyro_dps: Floats) -> Floats:
        given = replace(c, gyro_dps=gyro_dps)
        error, self._memory[effect_id] = CATALOGUE[effect_id].error_dps(
            given, self.spec.effects[effect_id], self.spec.gyro.surface, self._memory.get(effect_id)
        )
        return error


def _joined(blocks: list[Conditions]) -> Conditions:
    """Blocks in a row as one."""
    if len(blocks) == 1:
        return blocks[0]
    arrays = {
        f.name: np.concatenate([getattr(b, f.name) for b in blocks])
        for f in fields(Conditions)
        if isinstance(getattr(blocks[0], f.name), np.ndarray)
    }
    return Conditions(**arrays, dt_s=blocks[0].dt_s)
