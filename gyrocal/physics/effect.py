"""What an effect is: one small object that the bench injects, `diagnose` proposes and the runtime compensates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]

#: The families of physics.md: the level of naming that is almost always right.
FAMILIES = (
    "thermal transient",
    "time",
    "rate shape",
    "temperature shape",
    "angle, constant",
    "angle, with rate",
    "step",
    "supply",
    "sampling",
)


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: unit, physical bounds, and the size that is usual for an RD2100-class gyro."""

    name: str
    unit: str
    low: float
    high: float
    typical: float
    linear: bool
    meaning: str


@dataclass(frozen=True)
class Conditions:
    """What an effect may depend on, sample by sample, in time order. None: that channel is not known.

    Every array has shape (n,).
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

    def __len__(self) -> int:
        return int(self.t_s.size)

    def cut(self, rows: slice) -> Conditions:
        """The same, for some of the rows."""
        arrays: dict[str, Any] = {
            f.name: v[rows] for f in fields(self) if isinstance(v := getattr(self, f.name), np.ndarray)
        }
        return replace(self, **arrays)


#: What an effect remembers between blocks of samples (low-passed temperature, play positions, ...).
Memory = Any


class Response(Protocol):
    """The law of an effect over one block of samples.

    Blocks follow each other in time; feeding a record in any split gives the same numbers as feeding it whole.
    """

    def __call__(
        self, c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
    ) -> tuple[Floats, Memory]: ...


@dataclass(frozen=True)
class Effect:
    """An effect of the catalogue.

    Attributes
    ----------
    id : str
        Its name in every file.
    equation, statement, reference : str
        The law; what it is, in one plain sentence for a user; where it is written.
    needs : tuple of str
        Channels (fields of `Conditions`) without which it cannot be seen.
    seen_in : str
        Coordinate of formats.md where its residual has structure.
    looks_like : tuple of str
        Ids that the same data may not tell apart.
    runtime : bool
        Whether a robot can evaluate it (from gyro, temperature and its history, time since power-on).
    error_dps : Response
        ``(error in deg/s, memory)`` of a block; `memory` None at the start.
    """

    id: str
    family: str
    equation: str
    statement: str
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...]
    seen_in: str
    looks_like: tuple[str, ...]
    reference: str
    runtime: bool
    error_dps: Response = field(repr=False)

    def typical(self) -> dict[str, float]:
        """The usual size of each parameter."""
        return {p.name: p.typical for p in self.parameters}
