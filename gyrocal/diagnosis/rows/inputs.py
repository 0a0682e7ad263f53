"""What a recording must be before it is examined: an output that follows the rate, in deg/s."""

from __future__ import annotations

import numpy as np

from gyrocal.diagnosis.model.layers import free_terms
from gyrocal.diagnosis.remarks import Note, Remark, Said
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.order import one_way
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.table_series import FEWEST_ROWS
from gyrocal.diagnosis.rows.visited import tells_of_branches, visits_tell, visits_turned_at
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.offer import fell_c
from gyrocal.physics.surface import SHAPE
from gyrocal.records.scale import (
    Odd,
    copied_text,
    gross_row,
    odd_columns,
    odd_output,
    odd_rates,
    scale_unclipped,
    stray_rows,
    unclipped,
)
from gyrocal.units import plural

#: A scale error beyond this is said: data sheets are within a few per cent.
_SAID = 0.1
_OTHER = "Give the coefficients of this gyro, or leave them out to fit a surface first."


def check_inputs(
    series: Series, coefficients: Coefficients | None, *, ideal: bool = False
) -> tuple[Note, ...]:
    """Refuse too few rows, columns that are not what they say, a stuck gyro, a wild value, and another gyro's coefficients.

    A surface that is fitted first would swallow all of them. `ideal`: an output that is the rate itself is a simulation's.

    Returns
    -------
    notes : tuple of Note
        What is doubtful and goes on.

    Raises
    ------
    DataError
        With what is wrong, where, and what to do.
    """
    if len(series) < FEWEST_ROWS:
        raise DataError(
            f"{series.name}: has {len(series)} rows; a diagnosis needs at least {FEWEST_ROWS}. Record longer."
        )
    means, terms = len(means_of(series)), len(free_terms(series))
    if means <= terms:
        raise DataError(
            f"{series.name}: has {means} {plural(means, '[data set|data sets]')}, and the surface of its rates and "
            f"temperatures has {terms} {plural(terms, '[term|terms]')} that nothing holds; a diagnosis needs at least "
            f"{terms + 1} data sets. Record more."
        )
    columns = series.rate_dps, series.gyro_dps, series.temp_c
    odds = odd_columns(*columns, series.copies, series.set_index + 1, lines=series.is_table, ideal=ideal)
    for odd in odds:
        if coefficients is None or not odd.a_scale:
            raise DataError(f"{series.name}: {odd.what}. {odd.remedy}.")
    row = gross_row(series.rate_dps, series.gyro_dps)
    if row is not None:
        raise DataError(
            f"{series.name}: data set {series.set_index[row] + 1} ({series.rate_dps[row]:+.4g} deg/s, "
            f"{series.temp_c[row]:.1f} °C) says {series.gyro_dps[row]:.6g} deg/s, which no gyro does. Repair or remove it."
        )
    notes: tuple[Note, ...] = (
        *_stray_notes(series),
        *_one_way_notes(series),
        *_few_temperatures_notes(series),
    )
    in_radians = odd_rates(series.rate_dps) if series.is_table else None
    if in_radians is not None:
        notes += (f"{in_radians.what}. {in_radians.remedy}",)
    if series.copies and not ideal:
        notes += (copied_text(series.copies, len(series)),)
    if coefficients is not None:
        _check_coefficients(series, coefficients, odds[0] if odds else None)
        return notes
    off = scale_unclipped(series.rate_dps, series.gyro_dps) - 1.0
    return (*notes, Remark(Said.SCALE_FAR_OFF, {"ratio": 1.0 + off})) if abs(off) > _SAID else notes


def _stray_notes(series: Series) -> tuple[Remark, ...]:
    if not series.is_table:
        return ()
    free = np.flatnonzero(unclipped(series.rate_dps, series.gyro_dps, series.temp_c))
    stray = free[stray_rows(series.rate_dps[free], series.gyro_dps[free])]
    return (
        (Remark(Said.STRAY_SETS, {"sets": [int(series.set_index[row]) + 1 for row in stray]}),)
        if len(stray)
        else ()
    )


def went_one_way(series: Series) -> bool:
    """Whether the temperature did, so that what time did looks like what it did."""
    if np.ptp(series.rate_dps) == 0.0 or not np.any(carried_terms(series) % SHAPE[1]):
        return False
    return one_way(series.temp_c)


def _one_way_notes(series: Series) -> tuple[Remark, ...]:
    temp_c = series.temp_c
    return (
        (Remark(Said.ONE_WAY, {"rose": fell_c(temp_c) <= fell_c(-temp_c)}),) if went_one_way(series) else ()
    )


def _few_temperatures_notes(series: Series) -> tuple[Remark, ...]:
    """What is not looked for where the gyro turned at a few temperatures."""
    count = visits_turned_at(series.rate_dps, series.temp_c)
    if count == 0 or visits_tell(count):
        return ()
    return (Remark(Said.FEW_TEMPERATURES, {"count": count, "branches": tells_of_branches(series.temp_c)}),)


def _check_coefficients(series: Series, coefficients: Coefficients, odd: Odd | None) -> None:
    """Whether the surface given can be this gyro's: it has an output at every rate, and corrects to the rate."""
    try:
        coefficients.surface.output_dps(series.rate_dps, series.temp_c)
    except DataError as error:
        if odd is None:
            raise DataError(
                f"{_not_of(series, coefficients)}: it has no output at all for some of the rates. {_OTHER}"
            ) from error
        raise DataError(f"{series.name}: {odd.what}. {odd.remedy}.") from error
    corrected = coefficients.surface.rate_dps(series.gyro_dps, series.temp_c)
    still = odd_output(series.rate_dps, corrected)
    if still is None:
        return
    if odd is not None:
        raise DataError(f"{series.name}: {odd.what}. {odd.remedy}.")
    raise DataError(f"{_not_of(series, coefficients)}: corrected with it, {still.what}. {_OTHER}")


def _not_of(series: Series, coefficients: Coefficients) -> str:
    valid = coefficients.valid
    return (
        f"{series.name}: the surface given, calibrated for {valid.rate_dps[0]:.4g} to {valid.rate_dps[1]:.4g} deg/s and "
        f"{valid.temp_c[0]:.3g} to {valid.temp_c[1]:.3g} °C, cannot be this gyro's"
    )
