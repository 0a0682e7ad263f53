"""Parts of the error that have no name: smooth functions of the input rate, the temperature and their history.

A column is a product of three factors: one of the rate, one of the temperature, and a driver, which may remember.
A `SmoothTerm` is a sum of columns with coefficients. The same columns are the design matrix of who estimates the
coefficients and the correction of the robot that uses them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.physics.c_text import ABOVE, BUMP, LEGENDRE, CMemory, Number
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import ROBOT_CHANNELS, Floats
from gyrocal.physics.kernels import heat, lag, play
from gyrocal.physics.shapes import DRIVERS, RATE, TEMPERATURE, Driver, Frame, Shape, Trace
from gyrocal.physics.surface import Surface
from gyrocal.physics.thermal import temperature_rate_c_per_s

__all__ = [
    "Column", "Factor", "Frame", "SmoothTerm", "columns_of", "design", "histories", "rate_factors", "seen_of", "smooth_term",
    "temperature_factors",
]  # fmt: skip

#: How far a column may go beyond what was seen of it before it is flagged, as a share of the range seen:
#: means of data sets are a little narrower than the samples that they are means of.
SEEN_MARGIN = 0.1
#: Larger than any column.
_ANY_SIZE = 1e6


@dataclass(frozen=True)
class Factor:
    """A shape of `RATE`, `TEMPERATURE` or `DRIVERS`, and its numbers in the order that stands there."""

    kind: str = "one"
    numbers: tuple[float, ...] = ()


@dataclass(frozen=True)
class Column:
    """Factor of the input rate × factor of the temperature × driver."""

    rate: Factor = Factor()
    temperature: Factor = Factor()
    driver: Factor = Factor()


Memory = Mapping[Trace, Any] | None


def _trace(kind: str, number: float, c: Conditions, memory: Any) -> tuple[Floats, Any]:
    if kind == "lag":
        behind_c, memory = lag(c.t_s, c.temp_c, number, memory)
        return -behind_c, memory
    if kind == "rate":
        return temperature_rate_c_per_s(c, memory)
    if kind == "heat":
        return heat(c.t_s, c.rate_dps, number, memory)
    position_c, memory = play(c.temp_c, number, memory)
    return position_c - c.temp_c, memory


def histories(
    c: Conditions, frame: Frame, drivers: Iterable[Factor], memory: Memory = None
) -> tuple[dict[Factor, Floats], Memory]:
    """Values of drivers, sample by sample.

    Parameters
    ----------
    c : Conditions of n samples in time order
    memory : what the call before returned, None at the start; blocks of any split give the same numbers

    Returns
    -------
    values : for each driver an array of shape (n,): deg C (lag, band, play), deg C/s (temperature_rate), V (supply), V² (supply_squared), 1 (heat)
    memory : for the next block

    Raises
    ------
    DataError
        A driver needs the time since power-on, and the record has none.
    """
    wanted = dict.fromkeys(drivers)
    traces: dict[Trace, Floats] = {}
    after: dict[Trace, Any] = {}
    for driver in wanted:
        for kind, number in DRIVERS[driver.kind].traces(*driver.numbers):
            if (kind, number) not in traces:
                before = None if memory is None else memory[kind, number]
                traces[kind, number], after[kind, number] = _trace(kind, number, c, before)
    values = {d: DRIVERS[d.kind].value(c, frame, traces, *d.numbers) for d in wanted}
    return values, after


def rate_factors(rate_dps: ArrayLike, frame: Frame, factors: Iterable[Factor]) -> dict[Factor, Floats]:
    """Values of factors of the rate, each of the rates' shape."""
    u = np.asarray(rate_dps, dtype=np.float64) / frame.rate_scale_dps
    return {f: RATE[f.kind].value(u, frame, *f.numbers) for f in dict.fromkeys(factors)}


def temperature_factors(temp_c: ArrayLike, frame: Frame, factors: Iterable[Factor]) -> dict[Factor, Floats]:
    """Values of factors of the temperature, each of the temperatures' shape; NaN where it is not finite."""
    temp = np.asarray(temp_c, dtype=np.float64)
    v = (np.where(np.isfinite(temp), temp, np.nan) - frame.temp_center_c) / frame.temp_scale_c
    return {f: TEMPERATURE[f.kind].value(v, frame, *f.numbers) for f in dict.fromkeys(factors)}


def design(
    rate_dps: ArrayLike,
    temp_c: ArrayLike,
    frame: Frame,
    columns: Sequence[Column],
    drivers: Mapping[Factor, Floats],
) -> Floats:
    """Columns at rates and temperatures, with drivers that are known there (their means over data sets, say).

    Parameters
    ----------
    rate_dps, temp_c : array_like, shape (n,): true rate, temperature
    drivers : values of each column's driver, shape (n,), as `histories` gives them

    Returns
    -------
    ndarray, shape (n, p)
    """
    rates = rate_factors(rate_dps, frame, (c.rate for c in columns))
    temperatures = temperature_factors(temp_c, frame, (c.temperature for c in columns))
    out = np.empty((len(columns), np.size(rate_dps)))
    for row, column in zip(out, columns, strict=True):
        np.multiply(temperatures[column.temperature], drivers[column.driver], out=row)
        row *= rates[column.rate]
    return out.T


def columns_of(
    c: Conditions, frame: Frame, columns: Sequence[Column], memory: Memory = None
) -> tuple[Floats, Memory]:
    """Columns sample by sample, shape (n, p), and the memory for the next block (as in `histories`)."""
    drivers, memory = histories(c, frame, (column.driver for column in columns), memory)
    return design(c.rate_dps, c.temp_c, frame, columns, drivers), memory


@dataclass(frozen=True)
class SmoothTerm:
    """A part of the error without a name: ``e = sum of coefficient × column``, deg/s.

    Attributes
    ----------
    family, label : str
        What it belongs to (`effect.FAMILIES`), and how it is told from the others of a file.
    coefficients_dps : ndarray, shape (p,)
        deg/s for each unit of the column.
    covariance_dps2 : ndarray, shape (p, p), or (p, k)
        Of the coefficients; or their rows in the joint covariance of surface and terms, laid out as in
        `RuntimeTerm.covariance`.
    seen : ndarray, shape (p, 2)
        From which to which value each column is known: `seen_of`.
    """

    family: str
    label: str
    frame: Frame
    columns: tuple[Column, ...]
    coefficients_dps: Floats
    covariance_dps2: Floats
    seen: Floats

    def __post_init__(self) -> None:
        p = len(self.columns)
        shapes = {"coefficients_dps": (p,), "covariance_dps2": (p, None), "seen": (p, 2)}
        for name, shape in shapes.items():
            values = np.asarray(getattr(self, name), dtype=np.float64)
            fits = values.shape == shape or (shape[1:] == (None,) and values.ndim == 2 and len(values) == p)
            if not (p and fits and np.isfinite(values).all()):
                msg = (
                    f"{name} of the smooth term {self.label!r} does not fit its {p} columns, or is not finite"
                )
                raise ValueError(msg)
            object.__setattr__(self, name, values)

    @property
    def name(self) -> str:
        """Its label."""
        return self.label

    @property
    def runtime(self) -> bool:
        """Whether a robot has what its drivers need."""
        return self.channels.issubset(ROBOT_CHANNELS)

    @property
    def linked(self) -> bool:
        """Whether the covariance reaches over the surface and other terms."""
        return bool(self.covariance_dps2.shape[1] > len(self.columns))

    @property
    def rows(self) -> Floats:
        """The covariance."""
        return self.covariance_dps2

    @property
    def channels(self) -> frozenset[str]:
        """Fields of the conditions that its drivers cannot do without."""
        return frozenset(DRIVERS[c.driver.kind].channel for c in self.columns if c.driver != Factor())

    @property
    def has_memory(self) -> bool:
        """Whether it depends on earlier samples."""
        traces = (DRIVERS[c.driver.kind].traces(*c.driver.numbers) for c in self.columns)
        return any(len(trace) > 0 for trace in traces)

    @property
    def remembers_rates(self) -> bool:
        """Whether it depends on earlier rates."""
        return "rate_dps" in self.channels

    def at(
        self, c: Conditions, surface: Surface | None, memory: Memory
    ) -> Callable[[Floats], tuple[Floats, Memory]]:
        """Its error as a function of the true rate: what depends on temperature and history is worked out once."""
        drivers, after = histories(c, self.frame, (column.driver for column in self.columns), memory)
        temperatures = temperature_factors(
            c.temp_c, self.frame, (column.temperature for column in self.columns)
        )
        sizes: dict[Factor, Floats] = {}
        for column, coefficient in zip(self.columns, self.coefficients_dps, strict=True):
            size = coefficient * temperatures[column.temperature] * drivers[column.driver]
            sizes[column.rate] = sizes[column.rate] + size if column.rate in sizes else size

        def error_dps(rate_dps: Floats) -> tuple[Floats, Memory]:
            rates = rate_factors(rate_dps, self.frame, sizes)
            return np.asarray(sum(size * rates[factor] for factor, size in sizes.items())), after

        return error_dps

    def part(self) -> SmoothTerm:
        """Itself: it is what a robot evaluates."""
        return self

    def error_dps(self, c: Conditions, surface: Surface | None) -> Floats:
        """Its error over a whole record whose true rates are known, shape (n,)."""
        return self.at(c, surface, None)(c.rate_dps)[0]

    def tangent(
        self, c: Conditions, surface: Surface | None, error_dps: Floats, memory: Memory
    ) -> tuple[Floats, Memory]:
        """Its columns."""
        return columns_of(c, self.frame, self.columns, memory)

    def by_surface(self, c: Conditions, surface: Surface, memory: Memory) -> float:
        """Through none."""
        return 0.0

    def beyond(self, c: Conditions, tangent: Floats) -> NDArray[np.bool_]:
        """Where a column, shape (n, p), lies outside what was seen of it; shape (n,)."""
        low, high = self.seen.T
        margin = SEEN_MARGIN * (high - low)
        return np.asarray(((tangent < low - margin) | (tangent > high + margin)).any(axis=1))

    def c_laws(self, number: Number, memory: CMemory) -> tuple[list[str], tuple[str, ...]]:
        """C expressions that add up to its error (`c_text`), and the functions that they call."""
        laws = []
        for column, coefficient in zip(self.columns, self.coefficients_dps, strict=True):
            factors = (
                number(float(coefficient)),
                TEMPERATURE[column.temperature.kind].c(number, self.frame, *column.temperature.numbers),
                DRIVERS[column.driver.kind].c(number, self.frame, memory, *column.driver.numbers),
                RATE[column.rate.kind].c(number, self.frame, *column.rate.numbers),
            )
            laws.append(" * ".join(filter(None, factors)))
        helpers = {"PREFIX_above": ABOVE, "PREFIX_bump": BUMP, "PREFIX_legendre": LEGENDRE}
        return laws, tuple(text for name, text in helpers.items() if any(name in law for law in laws))

    def to_json(self) -> dict[str, Any]:
        """The entry of the coefficient file's ``terms``."""
        return {
            "effect": None,
            "runtime": self.runtime,
            "family": self.family,
            "label": self.label,
            "frame": dict(vars(self.frame)),
            "columns": [
                {
                    "rate": _to_json(column.rate, RATE),
                    "temperature": _to_json(column.temperature, TEMPERATURE),
                    "driver": _to_json(column.driver, DRIVERS),
                    "coefficient_dps": float(coefficient),
                    "seen": [float(x) for x in seen],
                }
                for column, coefficient, seen in zip(
                    self.columns, self.coefficients_dps, self.seen, strict=True
                )
            ],
            "covariance_dps2": self.covariance_dps2.tolist(),
        }


def seen_of(columns: Floats, sizes_dps: Floats, least_dps: float) -> Floats:
    """Smallest and largest value of each column in a record, and as far beyond as it adds next to nothing, shape (p, 2).

    Parameters
    ----------
    columns : ndarray, shape (n, p)
    sizes_dps : ndarray, shape (p,)
        What a column of one may add.
    least_dps : what is next to nothing
    """
    room = np.minimum(least_dps / np.maximum(sizes_dps, 1e-12), _ANY_SIZE)
    return np.column_stack([columns.min(axis=0) - room, columns.max(axis=0) + room])


def smooth_term(raw: Mapping[str, Any]) -> SmoothTerm:
    """The term of an entry that `SmoothTerm.to_json` wrote.

    Raises
    ------
    KeyError, TypeError, ValueError
        Not such an entry, or with shapes that this program does not know.
    """
    entries = raw["columns"]
    columns = tuple(
        Column(
            _from_json(x["rate"], RATE),
            _from_json(x["temperature"], TEMPERATURE),
            _from_json(x["driver"], DRIVERS),
        )
        for x in entries
    )
    return SmoothTerm(
        str(raw["family"]),
        str(raw["label"]),
        Frame(**{name: float(value) for name, value in raw["frame"].items()}),
        columns,
        np.array([x["coefficient_dps"] for x in entries], dtype=np.float64),
        np.array(raw["covariance_dps2"], dtype=np.float64),
        np.array([x["seen"] for x in entries], dtype=np.float64),
    )


def _to_json(factor: Factor, known: Mapping[str, Shape] | Mapping[str, Driver]) -> dict[str, Any]:
    return {"kind": factor.kind, **dict(zip(known[factor.kind].names, factor.numbers, strict=True))}


def _from_json(raw: Mapping[str, Any], known: Mapping[str, Shape] | Mapping[str, Driver]) -> Factor:
    kind = str(raw["kind"])
    if kind not in known:
        msg = f"the shape {kind!r} is not known; known are {', '.join(known)}"
        raise ValueError(msg)
    names = known[kind].names
    numbers = tuple(float(raw[name]) for name in names)
    for name, number in zip(names, numbers, strict=True):
        # A center is of either sign; an order, a width and a time constant are not.
        if not (np.isfinite(number) and (name.startswith("center") or number > 0)):
            msg = f"{name} of the shape {kind!r} is {number:g}"
            raise ValueError(msg)
    return Factor(kind, numbers)
