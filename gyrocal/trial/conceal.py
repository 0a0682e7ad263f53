"""Recordings with layers of physics hidden in them, and how strongly each shows once all else is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.trial.gyros import Gyro, powers, surface_columns
from gyrocal.trial.laws import Law
from gyrocal.trial.plans import Bench
from gyrocal.trial.sealed import Sealed

Floats = NDArray[np.float64]

#: Of a layer's signal this share at least is its own, the others being known: else nothing could tell them apart.
_OWN_SHARE = 0.3
#: And of its size before the surface is fitted: else it would have to be absurdly large to be seen.
_SEEN_SHARE = 0.03
_TRIES = 200
#: Against the surface in the true rate: from here on a sine is a sine, and no question of the surface's direction.
_SURE = 12.0


@dataclass(frozen=True)
class Layer:
    """A hidden law with its numbers.

    Attributes
    ----------
    d_prime : float
        Signal-to-noise ratio after the surface and all other layers are fitted under the true noise; of a front
        end against a surface in the output.
    d_prime_input : float
        The same against a surface in the true rate: differs for front ends only.
    rms_dps : float
        Size in the recording.
    """

    law: str
    right: tuple[str, ...]
    family: str
    stays: bool
    parameters: Mapping[str, float]
    amplitude: float
    d_prime: float
    d_prime_input: float
    rms_dps: float


@dataclass(frozen=True)
class Concealed(Sealed):
    """The answer of a recording: what it hides, in which gyro, on which plan; sealed with a nonce.

    Names in `also` are true of the recording though no layer has them: they count neither way.
    """

    kind: str
    gyro: str
    plan: str
    oddity: str
    also: tuple[str, ...]
    layers: tuple[Layer, ...]
    nonce: str


@dataclass(frozen=True)
class Hidden:
    """A law that is to be hidden: its parameters, and how large it is (1 for coils and front ends)."""

    law: Law
    parameters: Mapping[str, float]
    amplitude: float = 1.0

    def column(self, bench: Bench) -> Floats:
        """The unit error, or a coil's temperature."""
        return self.law.column(bench, self.parameters)


def coil_c(bench: Bench, hidden: Sequence[Hidden]) -> Floats:
    """Temperature that the surface lives at."""
    for h in hidden:
        if h.law.acts == "coil":
            return h.column(bench)
    return bench.temp_c


def error_dps(bench: Bench, gyro: Gyro, hidden: Sequence[Hidden]) -> Floats:
    """Output without noise, less the true rate."""
    surface = surface_columns(bench, coil_c(bench, hidden)) @ gyro.surface_dps
    parts = [h.amplitude * h.column(bench) for h in hidden if h.law.acts != "coil"]
    return np.asarray(np.sum([surface, *parts], axis=0))


def unit_columns(bench: Bench, gyro: Gyro, hidden: Sequence[Hidden]) -> Floats:
    """What each layer does, shape (n, layers), at an amplitude of 1."""
    there = surface_columns(bench, bench.temp_c) @ gyro.surface_dps
    return np.column_stack(
        [
            surface_columns(bench, h.column(bench)) @ gyro.surface_dps - there
            if h.law.acts == "coil"
            else h.column(bench)
            for h in hidden
        ]
    )


def d_primes(white: Floats, nuisances: int) -> tuple[Floats, Floats]:
    """Signal-to-noise ratios of whitened columns after the first `nuisances`: beside all others, and alone.

    A column that the others leave nothing of has 0.
    """
    beyond = white[:, nuisances:]
    beside = [_left(np.delete(white, nuisances + k, axis=1), c) for k, c in enumerate(beyond.T)]
    alone = [_left(white[:, :nuisances], c) for c in beyond.T]
    return np.array(beside), np.array(alone)


def _left(columns: Floats, y: Floats) -> float:
    size = np.linalg.norm(columns, axis=0)
    scaled = columns[:, size > 0] / size[size > 0]
    return float(np.linalg.norm(y - scaled @ np.linalg.lstsq(scaled, y, rcond=1e-10)[0]))


def draw_laws(
    pool: Sequence[Law], count: int, is_run: bool, rng: np.random.Generator, given: Sequence[Law] = ()
) -> list[Hidden]:
    """Laws with parameters, none of a group twice; `given` come first."""
    chosen = list(given)
    for k in rng.permutation(len(pool)).tolist():
        law = pool[k]
        if (
            len(chosen) < count
            and law.group not in {c.group for c in chosen}
            and (is_run or not law.run_only)
        ):
            chosen.append(law)
    return [Hidden(law, law.draw(rng)) for law in chosen]


def size_layers(
    bench: Bench, gyro: Gyro, hidden: Sequence[Hidden], wanted: Sequence[float], least: float
) -> list[Layer] | None:
    """Layers of the wanted strengths; None where one cannot be told from the others.

    Coils and front ends have the strength that their parameters give them: None where it is below `least`.
    """
    units = unit_columns(bench, gyro, hidden)
    design = np.hstack([surface_columns(bench, bench.temp_c), units])
    white = gyro.noise.whiten(bench, design)
    nuisances = design.shape[1] - len(hidden)
    beside, alone = d_primes(white, nuisances)
    layers = []
    for k, (h, target) in enumerate(zip(hidden, wanted, strict=True)):
        sized = h.law.acts == "adds"
        whole = float(np.linalg.norm(white[:, nuisances + k]))
        if sized and beside[k] < max(_OWN_SHARE * alone[k], _SEEN_SHARE * whole, 1e-12):
            return None
        size = target / beside[k] if sized else 1.0
        size = float(min(size, h.law.most))
        d_input = float(size * beside[k])
        d = _against_output(bench, gyro, hidden, white, nuisances + k) if h.law.acts == "front" else d_input
        if d < least:
            return None
        right = h.law.right[:1] if h.law.acts == "front" and d_input >= _SURE else h.law.right
        layers.append(
            Layer(
                h.law.name,
                right,
                CATALOGUE[h.law.right[0]].family,
                h.law.stays,
                dict(h.parameters),
                size,
                d,
                d_input,
                float(np.sqrt(np.mean((size * units[:, k]) ** 2))),
            )
        )
    return layers


def _against_output(bench: Bench, gyro: Gyro, hidden: Sequence[Hidden], white: Floats, column: int) -> float:
    """Strength of a front end, the surface being one of the output."""
    output = bench.rate_dps + error_dps(bench, gyro, [h for h in hidden if h.law.acts != "adds"])
    surface = gyro.noise.whiten(bench, powers(output / bench.frame.max_rate_dps, bench.v))
    others = np.delete(white[:, surface.shape[1] :], column - surface.shape[1], axis=1)
    return _left(np.hstack([surface, others]), white[:, column])


def with_sizes(hidden: Sequence[Hidden], layers: Sequence[Layer], rng: np.random.Generator) -> list[Hidden]:
    """Laws in their sizes; the sign is thrown where physics leaves it open."""
    out = []
    for h, layer in zip(hidden, layers, strict=True):
        free = h.law.acts == "adds" and not h.law.positive
        out.append(replace(h, amplitude=layer.amplitude * (float(rng.choice([-1.0, 1.0])) if free else 1.0)))
    return out


def hide(
    bench: Bench,
    gyro: Gyro,
    draw: Sequence[Law],
    count: int,
    strengths: Sequence[float],
    rng: np.random.Generator,
    *,
    given: Sequence[Law] = (),
    least: float = 0.0,
    fixed: Mapping[str, float] | None = None,
) -> tuple[list[Hidden], list[Layer]]:
    """Draw `count` laws that can be told apart, with strengths from `strengths`; `fixed` parameters are not drawn.

    Returns
    -------
    hidden, layers
        What acts in the recording, and what the answer says of it.
    """
    if not count:
        return [], []
    for _ in range(_TRIES):
        drawn = draw_laws(draw, count, bench.is_run, rng, given)
        drawn = [replace(h, parameters={**h.parameters, **_known(h, fixed or {})}) for h in drawn]
        wanted = rng.choice(np.asarray(strengths), size=len(drawn)).tolist()
        layers = size_layers(bench, gyro, drawn, wanted, least)
        if layers is not None:
            hidden = with_sizes(drawn, layers, rng)
            return hidden, [replace(a, amplitude=h.amplitude) for a, h in zip(layers, hidden, strict=True)]
    msg = f"no {count} laws of {gyro.model} can be told apart on this plan"
    raise RuntimeError(msg)


def _known(h: Hidden, fixed: Mapping[str, float]) -> dict[str, float]:
    return {k: v for k, v in fixed.items() if k in h.parameters}
