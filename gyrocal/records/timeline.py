"""The clock of a log while it is read in blocks: its unit, its order, and where it stepped."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError

Floats = NDArray[np.float64]

#: A step of more than this many usual steps, and of more than this time, is no lost sample: clock or logger stepped.
BOUNDARY_STEPS, BOUNDARY_S = 100.0, 10.0
#: Rows this far apart carry no drive and no noise of a gyro; they are milliseconds (or less) taken for seconds.
_LONGEST_USUAL_STEP_S = 2.0
#: Fewer steps than this do not tell what is usual.
_FEW_STEPS = 10
#: Times above these are since 1970 and not in seconds (100 billion seconds is the year 5138).
_EPOCH_UNITS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
_NAMES = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds"}


@dataclass
class Timeline:
    """Checks the times of `path` block by block and numbers the segments between steps of its clock.

    Parameters
    ----------
    usual_dt_s : float, s
        Of the log, from `usual_step`.
    closes : bool
        Whether rows behind a step go on one usual step after the row before it, as segments of one recording.
    """

    path: Path
    usual_dt_s: float
    closes: bool = True
    segment: int = 0
    last_s: float = -np.inf
    _shift_s: float = 0.0
    _said: list[str] = field(default_factory=list)

    def take(
        self, first_line: int, t_s: Floats, went_on: NDArray[np.bool_] | bool = False
    ) -> tuple[Floats, NDArray[np.int64], tuple[str, ...]]:
        """Times, segment numbers and sentences for a block, arrays of shape (n,).

        Parameters
        ----------
        went_on : rows that another column says to be as long after the row before as their times do

        Raises
        ------
        InputError
            A time that is empty, infinite or before the one above it.
        """
        bad = np.flatnonzero(~np.isfinite(t_s))
        if bad.size:
            raise InputError(
                f"{self.path}, line {first_line + bad[0]}: time is empty or not finite. Repair the log."
            )
        steps = np.diff(t_s, prepend=self.last_s)
        back = np.flatnonzero(steps < 0)
        if back.size:
            msg = f"{self.path}, line {first_line + back[0]}: time goes backwards by {-steps[back[0]]:.6g} s. Rows must be in time order; repair the log."
            raise InputError(msg)
        boundary = np.isfinite(steps) & (steps > max(BOUNDARY_STEPS * self.usual_dt_s, BOUNDARY_S))
        boundary &= ~np.asarray(went_on)
        segments = self.segment + np.cumsum(boundary)
        said = tuple(self._sentence(first_line + int(k), float(steps[k])) for k in np.flatnonzero(boundary))
        closed = t_s
        if self.closes:
            shift_s = self._shift_s + np.cumsum(np.where(boundary, steps - self.usual_dt_s, 0.0))
            closed = t_s - shift_s
            self._shift_s = float(shift_s[-1])
        self.segment, self.last_s = int(segments[-1]), float(t_s[-1])
        return closed, segments, said

    def _sentence(self, line: int, step_s: float) -> str:
        found = f"line {line}: time steps by {step_s:.6g} s, where rows come every {self.usual_dt_s:.3g} s"
        if not self.closes:
            return f"{found}; a segment of its own begins there"
        return f"{found}; the clock is taken to have stepped and the rows go on as another segment (if the logger paused, cut the file there)"


def usual_step(path: Path, t_s: Floats, *, mapped: bool = True) -> float:
    """Usual time step of a log, s, from the times `t_s` of its first rows; 0 where all are equal.

    Parameters
    ----------
    mapped : whether the command that reads it takes a mapping of its columns

    Raises
    ------
    InputError
        Times that cannot be in seconds.
    """
    finite = t_s[np.isfinite(t_s)]
    if finite.size == 0:
        return 0.0
    steps = np.diff(finite)
    steps = steps[steps > 0]
    usual_s = float(np.median(steps)) if steps.size else 0.0
    enough = steps.size >= _FEW_STEPS
    # How far apart rows are tells the unit first: times since power-on may be any number of nanoseconds.
    if enough and usual_s > _LONGEST_USUAL_STEP_S:
        unit = "ms" if usual_s < 5e3 else "us" if usual_s < 5e6 else "ns"
        _refuse(
            path, f"its rows would come every {usual_s:.6g} s; they look like {_NAMES[unit]}", unit, mapped
        )
    for border, unit in _EPOCH_UNITS:
        if abs(float(finite[-1])) > border:
            _refuse(path, f"its times ({finite[-1]:.6g}) are {_NAMES[unit]} since 1970", unit, mapped)
    return usual_s if enough else min(usual_s, _LONGEST_USUAL_STEP_S)


def _refuse(path: Path, what: str, unit: str, mapped: bool) -> None:
    mapping = f', or say its unit in a mapping with --columns: [columns.t_s] with unit = "{unit}"'
    raise InputError(f"{path}: t_s is in seconds, and {what}. Divide the column{mapping if mapped else ''}.")
