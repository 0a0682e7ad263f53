"""Concealed recordings: run directories with physics hidden in them, made by code that gyrocal does not share.

A helper of the tests, and a command line::

    python -m tests.diagnosis.concealed_bench --effect shupe --dprime 12 --seed 5 --out DIR

The answer is written beside the run, to ``DIR.answer.json``. d' is the signal-to-noise ratio of the effect under
the noise that is there, after twelve surface columns are projected out.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg, sparse, special

from tests.diagnosis.concealed_effects import CATALOGUE, OF_OUTPUT, OF_SURFACE, Drawn
from tests.diagnosis.concealed_outside import OUTSIDE
from tests.diagnosis.concealed_world import PLANS, STEP_S, Floats, World, build_world, first_order

EFFECTS = (*CATALOGUE, *OF_SURFACE, *OF_OUTPUT)
ROW_HEADER = "t_s,gyro_dps,gyro_temp_c,status,table_rate_dps,table_angle_deg,chamber_temp_c,supply_v\n"
#: Acts whose sign physics fixes: a coil follows, a sine and a knee lose gain.
ONE_SIGN = ("thermal_lag", "fit_direction", "truncation", "dead_zone", "sagnac_sine", "saturation")
_NODE_S = 12.0
_SAMPLE_NOISE_DPS = 4.4e-3
_SPECTRUM_SPANS = 4


@dataclass(frozen=True)
class NoiseLevels:
    """White noise in deg/s in one second, floor of the Allan deviation in deg/s, rate jitter a data set in ppm."""

    white_dps: float
    floor_dps: float
    jitter_ppm: float


@dataclass(frozen=True)
class Hidden:
    """An effect as it was hidden."""

    effect: str
    amplitude: float
    d_prime: float
    rms_dps: float
    parameters: Drawn


@dataclass(frozen=True, eq=False)
class Recording:
    """A bench run in memory: rows in time order, and the answer.

    ``effect_dps`` is the hidden error of each row, shape (effects, rows).
    """

    world: World
    noise: NoiseLevels
    seed: int
    gyro_t_s: Floats
    gyro_dps: Floats
    gyro_temp_c: Floats
    effect_dps: Floats
    hidden: tuple[Hidden, ...]
    yardstick: Yardstick | None

    def answer(self) -> dict[str, Any]:
        """What is hidden, as plain data."""
        return {
            "effects": [vars(h) for h in self.hidden],
            "noise": vars(self.noise),
            "seed": self.seed,
        }


def _surface(rng: np.random.Generator) -> Floats:
    """Twelve coefficients of a gyro of the class: about 2 % over temperature, 0.5 % nonlinear."""
    size = np.array([[0.03, 0.08, 0.03], [0.5, 0.95, 0.22], [0.14, 0.05, 0.001], [1.1, 0.12, 0.05]])
    return np.asarray(size * rng.uniform(0.7, 1.3, size.shape) * rng.choice([-1.0, 1.0], size.shape))


def _bend(c: Floats, x_dps: Floats, temp_c: Floats) -> Floats:
    """Error of the surface at rate variable `x_dps` (numpy's own two-dimensional polynomial)."""
    return np.asarray(np.polynomial.polynomial.polyval2d(x_dps / 100.0, (temp_c - 20.0) / 30.0, c))


def _output(c: Floats, rate_dps: Floats, temp_c: Floats) -> Floats:
    """Output whose error by the surface leads back to the rate: fixed-point iteration, contraction 0.04."""
    y = rate_dps
    for _ in range(9):
        y = rate_dps + _bend(c, y, temp_c)
    return y


def _flicker_power(n: int, step_s: float, floor_dps: float) -> Floats:
    """Variance of each Fourier coefficient of 1/f noise whose Allan deviation is flat at `floor_dps`."""
    f = np.fft.rfftfreq(n, step_s)
    density = np.zeros(f.size)
    density[1:] = (floor_dps / 0.664) ** 2 / (2 * np.pi * f[1:])
    return density * n / step_s


def _flicker(n: int, floor_dps: float, rng: np.random.Generator) -> Floats:
    long = _SPECTRUM_SPANS * n
    scale = np.sqrt(_flicker_power(long, STEP_S, floor_dps) / 2)
    spectrum = scale * (rng.normal(size=scale.size) + 1j * rng.normal(size=scale.size))
    return np.fft.irfft(spectrum, long)[:n]


class Yardstick:
    """Signal-to-noise ratio of a signal in the rows of a world, under given noise, the surface projected out."""

    def __init__(self, w: World, noise: NoiseLevels, columns: Floats) -> None:
        self._t = w.rows(w.t_s)
        seconds = w.row_seconds()
        self._weight = 1.0 / (noise.white_dps**2 / seconds)
        nodes = int(np.ceil(w.t_s[-1] / _NODE_S)) + 1
        left = np.minimum((self._t / _NODE_S).astype(int), nodes - 2)
        share = self._t / _NODE_S - left
        sets, rows = w.row_set(), np.arange(self._t.size)
        spread = sparse.csr_matrix(
            (
                np.concatenate([1 - share, share, w.rows(np.abs(w.rate_dps))]),
                (np.tile(rows, 3), np.concatenate([left, left + 1, nodes + sets])),
            ),
            shape=(self._t.size, nodes + len(w.pieces)),
        )
        long = _SPECTRUM_SPANS * nodes
        covariance = np.fft.irfft(_flicker_power(long, _NODE_S, noise.floor_dps), long)[:nodes] / long
        root = np.linalg.cholesky(linalg.toeplitz(covariance) + 1e-6 * covariance[0] * np.eye(nodes))
        jitter = np.full(len(w.pieces), max(noise.jitter_ppm, 1e-3) * 1e-6)
        self._spread, self._root = spread, linalg.block_diag(root, np.diag(jitter))
        weighted = sparse.diags_array(self._weight) @ spread
        inner = (spread.T @ weighted) @ self._root
        self._factor = linalg.cho_factor(np.eye(self._root.shape[0]) + self._root.T @ inner)
        self._columns = columns

    def _information(self, z: Floats) -> Floats:
        """``Z' V^-1 Z`` by the Woodbury identity, V white plus smooth plus jitter."""
        weighted = z * self._weight[:, None]
        low = self._root.T @ (self._spread.T @ weighted)
        return np.asarray(z.T @ weighted - low.T @ linalg.cho_solve(self._factor, low))

    def d_prime(self, signal: Floats) -> float:
        """d' of `signal`, one value a row."""
        return 1.0 / self.amplitude(signal, signal)[1]

    def amplitude(self, signal: Floats, data: Floats) -> tuple[float, float]:
        """Best estimate, by who knows the noise and the signal, of how much of `signal` is in `data`; its deviation."""
        z = np.column_stack([self._columns, signal, data])
        information = self._information(z)
        scale = np.sqrt(np.diag(information))
        scale[scale == 0] = 1.0
        information /= np.outer(scale, scale)
        q, values, _ = np.linalg.svd(information[:-2, :-2], hermitian=True)
        q = q[:, values > 1e-12 * values[0]] / np.sqrt(values[values > 1e-12 * values[0]])
        left = information[-2:, -2:] - (q.T @ information[:-2, -2:]).T @ (q.T @ information[:-2, -2:])
        own = max(left[0, 0], 1e-30)
        return float(left[0, 1] / own * scale[-1] / scale[-2]), float(1.0 / (np.sqrt(own) * scale[-2]))


def _unit_effect(
    name: str, w: World, surface: Floats, output: Floats, rng: np.random.Generator
) -> tuple[Floats, Drawn]:
    """Error of an effect at unit size on the fine grid, and what was drawn for it."""
    if name == "thermal_lag":
        tau = rng.uniform(90, 600)
        coil = first_order(w.case_c, tau, w.case_c[0])
        return _bend(surface, output, coil) - _bend(surface, output, w.case_c), {"tau_s": tau}
    if name == "fit_direction":
        return _bend(surface, w.rate_dps, w.case_c) - _bend(surface, output, w.case_c), {}
    if name == "truncation":
        # Mean loss with a step of 1 mdeg/s: toward zero of the output, smeared where its noise crosses zero.
        return -0.5e-3 * special.erf(output / (np.sqrt(2.0) * _SAMPLE_NOISE_DPS)), {}
    maker = CATALOGUE[name] if name in CATALOGUE else OUTSIDE[name][0]
    return maker(w, rng)


def _surface_columns(x_dps: Floats, temp_c: Floats) -> Floats:
    return np.asarray(np.polynomial.polynomial.polyvander2d(x_dps / 100.0, (temp_c - 20.0) / 30.0, [3, 2]))


def _burst(w: World, level: float, rng: np.random.Generator) -> Floats:
    """Short bursts of noise while the table turns, about `level` of them a data set."""
    out = np.zeros(w.t_s.size)
    for p in w.pieces:
        if p.kind != "rate":
            continue
        for _ in range(rng.poisson(level)):
            at = int(rng.integers(p.start, p.stop))
            end = min(at + int(rng.integers(2, 8)), p.stop)
            out[at:end] += rng.normal(size=end - at) * 0.06
    return out


def make_recording(
    effects: list[tuple[str, float]],
    seed: int,
    plan: str | None = None,
    noise: NoiseLevels | None = None,
    supply_steps: bool | None = None,
) -> Recording:
    """Record a gyro that hides `effects`, each with its d' (for `OF_OUTPUT` effects its level; see `_at_output`).

    Deterministic in its arguments. What is not given is drawn from the seed.
    """
    rng = np.random.default_rng([20261121, seed])
    drawn_plan = str(rng.choice(["even", "fine", "near_zero"]))
    drawn_steps = bool(rng.random() < 0.5) or any(e == "supply_times_rate" for e, _ in effects)
    drawn_noise = NoiseLevels(1.389e-3, 1e-3 * rng.uniform(0.4, 0.65), rng.uniform(0, 4))
    noise = noise or drawn_noise
    w = build_world(PLANS[plan or drawn_plan], drawn_steps if supply_steps is None else supply_steps, rng)
    surface = _surface(rng)
    jitter = np.zeros(w.t_s.size)
    for p in w.pieces:
        jitter[p.start : p.stop] = rng.normal() * noise.jitter_ppm * 1e-6
    clean = _output(surface, w.rate_dps, w.case_c)
    columns = np.column_stack([w.rows(c) for c in _surface_columns(clean, w.case_c).T])
    measured = [(e, s) for e, s in effects if e not in OF_OUTPUT]
    yardstick = Yardstick(w, noise, columns) if measured else None
    hidden, rows, total, lost = [], [], np.zeros(w.t_s.size), np.zeros(w.t_s.size)
    scatter = np.ones(w.t_s.size)
    for name, d_prime in measured:
        unit, drawn = _unit_effect(name, w, surface, clean, rng)
        in_rows = w.rows(unit)
        reach = yardstick.d_prime(in_rows) if yardstick else 1.0
        # The surface of a real gyro is cubic in the one or in the other: nothing to scale.
        size = 1.0 if name == "fit_direction" else d_prime / reach
        sign = 1.0 if name in ONE_SIGN else rng.choice([-1.0, 1.0])
        total += sign * size * unit
        lost += sign * size * unit if name == "truncation" else 0.0
        rows.append(sign * size * in_rows)
        if name == "mechanical_resonance":
            scatter += 2.0 * np.abs(unit) / np.abs(unit).max()
        rms = float(np.sqrt(np.mean(rows[-1] ** 2)))
        hidden.append(Hidden(name, float(sign * size), size * reach, rms, drawn))
    white = rng.normal(size=w.t_s.size) * noise.white_dps / np.sqrt(STEP_S) * scatter
    flicker = _flicker(w.t_s.size, noise.floor_dps, rng)
    output = clean + total + jitter * w.rate_dps + white + flicker
    lattice = sum(h.amplitude * 1e-3 for h in hidden if h.effect == "truncation")
    if lattice:
        # The loss is in `output` as its mean; the lattice itself is toward zero, so the mean is put back first.
        output = np.trunc((output - lost) / lattice) * lattice
    for name, level in effects:
        if name == "bursts":
            output = output + _burst(w, level, rng)
        elif name == "quantisation":
            output = np.round(output / (level * 1e-3)) * level * 1e-3
        elif name == "time_base":
            output = output * (1.0 + level * 1e-6)
        else:
            continue
        hidden.append(Hidden(name, level, float("nan"), float("nan"), {}))
    stretch = 1.0 + 1e-6 * sum(level for name, level in effects if name == "time_base")
    temps = w.rows(w.case_c)
    return Recording(
        w,
        noise,
        seed,
        _row_times(w, stretch),
        w.rows(output),
        temps + rng.normal(size=temps.size) * 0.01,
        np.array(rows).reshape(len(rows), temps.size),
        tuple(hidden),
        yardstick,
    )


def _row_times(w: World, stretch: float) -> Floats:
    """Time stamp of each row, the middle of what it averages, by a sample clock that is off by `stretch`."""
    times = []
    for p in w.pieces:
        begin = w.t_s[p.start] - STEP_S / 2
        times.append(begin + (w.t_s[p.start : p.stop].reshape(-1, p.per_row).mean(axis=1) - begin) * stretch)
    return np.concatenate(times)


def _segment_text(
    r: Recording, k: int, first: int, rng: np.random.Generator
) -> tuple[str, int, float, float]:
    """CSV of segment `k`, its gyro rows, and its first and last time."""
    w, p = r.world, r.world.pieces[k]
    n = (p.stop - p.start) // p.per_row
    t = r.gyro_t_s[first : first + n]
    limit = w.t_s[p.stop - 1] + STEP_S / 2
    n = int(np.sum(t <= limit + 1e-9))
    t = t[:n]
    lines = [
        (time, f"{time:.3f},{rate:.6f},{temp:.3f},0,,,,")
        for time, rate, temp in zip(
            t, r.gyro_dps[first : first + n], r.gyro_temp_c[first : first + n], strict=True
        )
    ]
    # The bench is read once a second, a little after the gyro row that begins with it.
    seconds = np.arange(t[0], limit, 1.0) + 0.013
    angle, air, volts = (np.interp(seconds, w.t_s, x) for x in (w.angle_deg, w.air_c, w.supply_v))
    volts = volts + rng.normal(size=volts.size) * 0.004
    lines += [
        (time, f"{time:.3f},,,,{p.rate_dps:.6f},{a:.5f},{c:.3f},{v:.3f}")
        for time, a, c, v in zip(seconds, angle, air, volts, strict=True)
    ]
    text = io.StringIO()
    text.write(ROW_HEADER)
    text.write("\n".join(line for _, line in sorted(lines, key=lambda pair: pair[0])) + "\n")
    return text.getvalue(), n, float(t[0]), float(t[-1])


def write_run(r: Recording, directory: Path) -> None:
    """Write `r` as a run directory, ``gyrocal-run/1``; the answer is not in it."""
    rng = np.random.default_rng([7, r.seed])
    (directory / "data").mkdir(parents=True)
    head = {
        "schema": "gyrocal-run/1",
        "created_utc": "2026-01-01T00:00:00Z",
        "sensor": {
            "model": "RD2100-class",
            "serial": f"C{r.seed:06d}",
            "rate_range_dps": [-100, 100],
            "temp_range_c": [-10, 50],
            "sample_rate_hz": 10.0,
        },
        "bench": {"latitude_deg": 42.3, "table": "generic", "chamber": "generic"},
        "power_on_t_s": 0.0,
    }
    (directory / "run.json").write_text(json.dumps(head, indent=1))
    journal, first = [], 0
    for k, p in enumerate(r.world.pieces):
        text, n, start, end = _segment_text(r, k, first, rng)
        first += (p.stop - p.start) // p.per_row
        name = f"data/{k + 1:04d}_{p.kind}_{p.rate_dps:+08.3f}dps_{p.chamber_c:+06.1f}C.csv"
        (directory / name).write_text(text)
        line = {
            "event": "segment",
            "id": k + 1,
            "kind": p.kind,
            "rate_dps": p.rate_dps,
            "chamber_c": p.chamber_c,
            "t_start_s": round(start, 3),
            "t_end_s": round(end, 3),
            "n": n,
            "averaging_s": p.per_row * STEP_S,
            "outcome": "ok",
            "file": name,
            "sha256": hashlib.sha256(text.encode()).hexdigest(),
        }
        journal.append(json.dumps(line))
    (directory / "journal.jsonl").write_text("\n".join(journal) + "\n")


def main() -> None:
    """Write one concealed recording."""
    parser = argparse.ArgumentParser(description="Write a concealed recording.")
    parser.add_argument("--effect", action="append", default=[], choices=[*EFFECTS, *OUTSIDE])
    parser.add_argument("--dprime", type=float, action="append", default=[])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--plan", choices=list(PLANS))
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if len(args.effect) != len(args.dprime):
        parser.error("give one --dprime for each --effect")
    r = make_recording(list(zip(args.effect, args.dprime, strict=True)), args.seed, args.plan)
    write_run(r, args.out)
    args.out.with_name(args.out.name + ".answer.json").write_text(json.dumps(r.answer(), indent=1))


if __name__ == "__main__":
    main()
