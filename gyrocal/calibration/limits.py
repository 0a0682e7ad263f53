"""Limits of a customer: read from a file, and judged with the uncertainty of the figure as guard band."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from gyrocal.calibration.figure import Figure
from gyrocal.errors import ProfileError
from gyrocal.records.files import reading

#: ``open``: the interval, or the bound, reaches over the limit, so that the measurement cannot tell.
Judgement = Literal["pass", "fail", "open", "not tested"]

#: Figures of the record and not of the unit: beyond what it reached nothing was tested, and nobody failed.
_OF_RECORD = frozenset({"maximum_rate_tested"})


@dataclass(frozen=True)
class Row:
    """A figure of the dossier and its judgement.

    Attributes
    ----------
    before, after : Figure or None
        Before compensation and after it. None where compensation makes no difference, or where the figure is only of
        the compensated gyro.
    """

    before: Figure | None
    after: Figure | None
    judgement: Judgement | None = None
    limit: str = ""

    @property
    def known(self) -> Figure:
        """The figure itself, before compensation where there are two."""
        figure = self.before or self.after
        if figure is None:
            raise ValueError("a row without a figure")
        return figure


@dataclass(frozen=True)
class Limit:
    """What a figure has to keep, before or after compensation.

    Attributes
    ----------
    most, least : float, optional
        Of its size, whatever its sign.
    low, high : float, optional
        Of the figure with its sign.
    """

    most: float | None = None
    least: float | None = None
    low: float | None = None
    high: float | None = None
    state: Literal["before", "after"] = "before"

    @property
    def signed(self) -> bool:
        """Whether the sign counts."""
        return self.low is not None or self.high is not None

    @property
    def span(self) -> tuple[float, float]:
        """Between what the figure, or its size, has to lie."""
        low, high = (self.low, self.high) if self.signed else (self.least, self.most)
        return -math.inf if low is None else low, math.inf if high is None else high

    def said(self, unit: str) -> str:
        """The limit in signs."""
        low, high = self.span
        middle = "x" if self.signed else "|x|"
        below = f"{low:g} ≤ " if math.isfinite(low) else ""
        above = f" ≤ {high:g}" if math.isfinite(high) else ""
        if below and not above:
            return f"{middle} ≥ {low:g} {unit}"
        return f"{below}{middle}{above} {unit}"


_NUMBERS = tuple(field.name for field in fields(Limit) if field.name != "state")


def read_limits(path: Path) -> dict[str, Limit]:
    """Read a limits file: ``bias_instability = { most = 3.0 }``, ``bias = { low = -2.0, high = 5.0, state = "after" }``.

    Raises
    ------
    InputError, ProfileError
        A file that cannot be read, or an entry that is no limit. Names are checked where the figures are known.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{path}: is not TOML ({error}). Correct that line.") from error
    if not raw:
        raise ProfileError(f"{path}: holds no limit. Write one a line: bias_instability = {{ most = 3.0 }}.")
    limits = {}
    for name, entry in raw.items():
        limit = _limit(entry) if isinstance(entry, dict) else None
        if limit is None:
            raise ProfileError(
                f"{path}: {name} is {entry!r}; wanted is {{ most = NUMBER }} above 0, least, or both, for its size, or low, high, or "
                'both, in order, for the figure with its sign; with state = "before" or "after".'
            )
        limits[name] = limit
    return limits


def _limit(entry: Mapping[str, Any]) -> Limit | None:
    """None where the entry is no limit."""
    numbers = {key: value for key, value in entry.items() if key != "state"}
    finite = all(type(v) in (int, float) and math.isfinite(v) for v in numbers.values())
    if not numbers or not set(numbers) <= set(_NUMBERS) or not finite:
        return None
    limit = Limit(**{k: float(v) for k, v in numbers.items()}, state=entry.get("state", "before"))
    sized = limit.most is not None or limit.least is not None
    low, high = limit.span
    good = limit.state in ("before", "after") and low < high and not (sized and limit.signed)
    return limit if good and (limit.signed or (high > 0 and low != 0 and low >= -math.inf)) else None


def judged(row: Row, limit: Limit | None) -> Row:
    """Pass where all of the interval is inside the limit, fail where all of it is outside (ISO 14253-1's guard band).

    The interval leaves 2.5 % on either side, so that a unit just beyond a limit passes, and one just inside it fails, once
    in forty at the most. A figure that has only a bound is anywhere up to it.
    """
    if limit is None:
        return row
    state = row.after if limit.state == "after" else row.before
    figure = state or row.known
    text = limit.said(figure.unit) + (f", {limit.state}" if row.before and row.after else "")
    return replace(row, judgement=_judgement(figure, limit), limit=text)


def _judgement(figure: Figure, limit: Limit) -> Judgement:
    if figure.high is None:
        return "not tested"
    low, high = (-figure.high if limit.signed else 0.0, figure.high)
    if figure.interval is not None:
        low, high = figure.interval[1:]
    if not limit.signed:
        least = 0.0 if low <= 0 <= high else min(abs(low), abs(high))
        low, high = least, max(abs(low), abs(high))
    lowest, highest = limit.span
    if low >= lowest and high <= highest:
        return "pass"
    if figure.name in _OF_RECORD and high < lowest:
        return "not tested"
    return "fail" if low > highest or high < lowest else "open"
