"""What the navigators of a replay are given: rows on one clock, the rest at the start, the noise of the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.fusion import (
    Aligner,
    Coefficients,
    Compensator,
    Navigator,
    RobotParameters,
    Rows,
    static_bias,
)
from gyrocal.navigation.channels import held
from gyrocal.navigation.levels import fit_noise
from gyrocal.navigation.track import Rest
from gyrocal.records.drive import DriveBlock, cut, join
from gyrocal.records.robot import Robot

Floats = NDArray[np.float64]

#: Rows from which the noise is estimated, at most: the first of the log.
FITTED_ROWS = 60_000


@dataclass(frozen=True)
class DriveSource:
    """A drive log that can be read more than once: `blocks()` starts from the beginning."""

    name: str
    blocks: Callable[[], Iterator[DriveBlock]]


@dataclass(frozen=True)
class Equipment:
    """All that a navigator is made of; `rest` is None where the robot does not stand at the start."""

    robot: RobotParameters
    kind: str
    coefficients: Coefficients | None
    rest: Rest | None
    power_on_t_s: float | None

    def navigator(self, robot: RobotParameters | None = None, *, filtering: bool = True) -> Navigator:
        """A navigator that starts at the first row, of this robot or of another one."""
        return Navigator(
            robot or self.robot,
            self.coefficients,
            kind=self.kind,
            filtering=filtering,
            static_bias_dps=self.rest.bias.bias_dps if self.rest else None,
            static_temp_c=self.rest.temp_c if self.rest else None,
            power_on_t_s=self.power_on_t_s,
        )


def equip(
    source: DriveSource,
    robot: Robot,
    kind: str,
    coefficients: Coefficients | None,
    power_on_t_s: float | None,
    *,
    sides: bool = True,
) -> Equipment:
    """What this log and the robot file give; for the model with the noise that the file leaves open.

    Parameters
    ----------
    sides : bool
        Whether the log has a distance of each side.

    Raises
    ------
    DataError
        No rest at the start where the robot file says that there is one.
    """
    rest = _rest(source, robot, coefficients, power_on_t_s) if robot.static_s > 0.0 else None
    equipment = Equipment(robot.parameters, kind, coefficients, rest, power_on_t_s)
    if kind == "paper":
        return equipment
    parameters = fit_noise(_first(source, robot.parameters), robot, equipment.navigator, sides=sides)
    return Equipment(parameters, kind, coefficients, rest, power_on_t_s)


def aligned(source: DriveSource, parameters: RobotParameters) -> Iterator[tuple[Rows, Floats]]:
    """Rows on one clock, and the truth that was logged with them, shape (n, 3)."""
    aligner = Aligner(parameters)
    waiting = np.empty((0, 3))
    for block in source.blocks():
        truth = np.stack([block.truth_x_m, block.truth_y_m, block.truth_heading_deg], axis=1)
        waiting = np.concatenate([waiting, truth]) if waiting.size else truth
        rows = aligner.push(block.t_s, block.left_m, block.right_m, block.gyro_dps, block.gyro_temp_c)
        yield rows, waiting[: rows.t_s.size]
        waiting = waiting[rows.t_s.size :]
    rows = aligner.flush()
    if rows.t_s.size:
        yield rows, waiting


def _first(source: DriveSource, parameters: RobotParameters) -> Rows:
    """The first `FITTED_ROWS` rows."""
    parts: list[Rows] = []
    for rows, _ in aligned(source, parameters):
        parts.append(rows)
        if sum(p.t_s.size for p in parts) >= FITTED_ROWS:
            break
    columns = zip(*(vars(p).values() for p in parts), strict=True)
    return Rows(*[np.concatenate(c)[:FITTED_ROWS] for c in columns])


def _rest(
    source: DriveSource, robot: Robot, coefficients: Coefficients | None, power_on_t_s: float | None
) -> Rest:
    """Static bias of the raw rates, or of the compensated ones."""
    head = _head(source, robot.static_s)
    rate = head.gyro_dps
    if coefficients is not None:
        since_s = None if power_on_t_s is None else head.t_s - power_on_t_s
        rate = Compensator(coefficients).correct(head.t_s, rate, held(head.gyro_temp_c), since_s)
    try:
        bias = static_bias(head.t_s, head.left_m, head.right_m, rate, robot.static_s)
    except DataError as error:
        raise DataError(f"{source.name}: {error}") from error
    warm = head.gyro_temp_c[np.isfinite(head.gyro_temp_c)]
    return Rest(bias, float(warm.mean()) if warm.size else None)


def _head(source: DriveSource, static_s: float) -> DriveBlock:
    """Rows of the rest at the start."""
    parts: list[DriveBlock] = []
    for block in source.blocks():
        start_s = parts[0].t_s[0] if parts else block.t_s[0]
        rows = int(np.searchsorted(block.t_s, start_s + static_s, side="right"))
        parts.append(cut(block, slice(rows)))
        if rows < len(block):
            break
    return join(parts)
