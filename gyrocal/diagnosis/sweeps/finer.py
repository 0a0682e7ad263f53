"""Shapes between those of a grid, where a record tells these far apart: what lies between two of them other parts would make up for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

Value = TypeVar("Value", bound=float)

#: A grid is fine enough where the square of its step is less than this, in deviations of the value.
_TOLD_APART = 4.0
#: A step is halved so often at the most: a grid as fine as the output has digits tells no more.
_HALVINGS = 5


def neighbours(grid: Sequence[Value], value: Value) -> list[Value]:
    """The values before and after one of a grid."""
    if value not in grid:
        return []
    at = grid.index(value)
    return [grid[k] for k in (at - 1, at + 1) if 0 <= k < len(grid)]


def halved(grid: list[float], at: float, cost: Callable[[float], float]) -> float:
    """The best value near one of a grid, after its steps there were halved until the record tells them apart no more.

    Parameters
    ----------
    grid : ascending; what was tried becomes part of it
    cost : negative log evidence of a value, nats: near the best one half of the square of its distance in deviations
    """
    for _ in range(_HALVINGS):
        near = neighbours(grid, at)
        if len(near) < 2 or sum(map(cost, near)) - 2.0 * cost(at) < _TOLD_APART:
            break
        between = [_middle(at, x) for x in near]
        grid[:] = sorted({*grid, *between})
        at = min((at, *between), key=cost)
    return at


def _middle(one: float, other: float) -> float:
    """Geometric between two of one sign, to as many digits as matter."""
    return float(f"{(one * other) ** 0.5 if one > 0.0 < other else 0.5 * (one + other):.6g}")
