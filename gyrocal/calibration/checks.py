"""Whether the data can carry the fit: asked before it, answered with what is missing and what to measure."""

from __future__ import annotations

import numpy as np

from gyrocal.calibration.datasets import DataSets, Recording
from gyrocal.calibration.fit import TERMS, SurfaceFit, rms, scaled_surface
from gyrocal.calibration.groups import determined_order, distinct
from gyrocal.errors import DataError
from gyrocal.physics.surface import RATE_ORDER, SHAPE, TEMPERATURE_ORDER
from gyrocal.records.scale import copied_text, copies, gross_row, odd_columns, odd_rates
from gyrocal.units import plural

#: Least span of temperature, °C, that a calibration over temperature means anything for.
LEAST_TEMPERATURE_SPAN_C = 3.0
#: The smaller of the two signs' largest rates, as a share of the larger.
_OTHER_SIGN = 0.2
#: A scaled design above this condition has columns that the data do not tell apart (a full grid has 25).
_WORST_CONDITION = 1e4
#: Rounding of the temperature that may explain this share of the residual, and up to twice the residual, matters.
_ROUNDING_SHARE = 0.5
#: More data sets than this make the covariance matrix too large.
MOST_DATA_SETS = 3000
_LISTED = 6


def check_surface(
    recording: Recording, sets: DataSets, *, force: bool = False, paper: bool = False
) -> tuple[str, ...]:
    """Refuse data that cannot carry a surface over rate and temperature.

    Parameters
    ----------
    sets : DataSets
        Those that go into the fit.
    force : bool
        Turn what is doubtful (saturated, stuck) into notes. What is missing stays an error.
    paper : bool
        All twelve terms are asked for.

    Returns
    -------
    notes : tuple of str

    Raises
    ------
    DataError
        With what is missing and what to measure.
    """
    source = recording.source
    rates = distinct(sets.rate_dps)
    if rates == 1:
        raise DataError(
            f"{source}: a recording at one rate ({sets.rate_dps[0]:+.4g} deg/s) carries no surface. "
            "Record at least 4 rates of both signs, take it as bias over temperature with gyrocal fit --bias-only, or take noise and "
            f"bias of a gyro at rest with gyrocal noise {source}."
        )
    if len(sets) <= TERMS:
        raise DataError(
            f"{source}: {len(sets)} data sets for {TERMS} coefficients are too few. "
            "Record at least 4 rates at each of 3 temperatures, and some more to see the scatter."
        )
    if len(sets) > MOST_DATA_SETS:
        raise DataError(
            f"{source}: {len(sets)} data sets are more than the fit takes ({MOST_DATA_SETS}). "
            "Average neighbouring rows of the same rate and temperature into one data set."
        )
    _check_rates(recording, sets, rates)
    of_temperatures = _check_temperatures(recording, sets, "surface", paper=paper)
    if float(np.ptp(sets.gyro_dps)) == 0:
        raise DataError(
            f"{source}: the gyro says {sets.gyro_dps[0]:.6g} at every rate: it is stuck. "
            "Check its power and its cable, and record again."
        )
    notes = of_temperatures + _check_unit(recording, sets, force)
    determined = np.arange(TERMS) % SHAPE[1] <= determined_order(sets.temp_c)
    condition = np.linalg.cond(scaled_surface(sets).design(sets.gyro_dps, sets.temp_c)[:, determined])
    if not condition < _WORST_CONDITION:
        raise DataError(
            f"{source}: rates and temperatures do not vary independently (condition {condition:.2g} of the scaled "
            f"design; a full grid has 25). Record every rate at 3 temperatures at least."
        )
    return notes + _doubts(recording, sets, force)


def _check_rates(recording: Recording, sets: DataSets, rates: int) -> None:
    source = recording.source.as_posix()
    low, high = float(sets.rate_dps.min()), float(sets.rate_dps.max())
    if low >= 0 or high <= 0 or min(-low, high) < _OTHER_SIGN * max(-low, high):
        raise DataError(
            f"{source}: rates run from {low:+.4g} to {high:+.4g} deg/s: one sign only. "
            "Record the same rates in the other direction too; the error need not be odd in the rate."
        )
    if rates < RATE_ORDER + 1:
        raise DataError(
            f"{source}: {rates} distinct rates do not carry order {RATE_ORDER} in rate. "
            f"Record at least {RATE_ORDER + 1}, spread over the range of the gyro{_of_rests(recording)}."
        )


def _of_rests(recording: Recording) -> str:
    """What a run of few rates is good for, at the end of a sentence."""
    if recording.run is None:
        return ""
    return f"; what its rests say of noise, bias and drift is gyrocal noise {recording.source.as_posix()}"


def _check_temperatures(
    recording: Recording, sets: DataSets, what: str, *, paper: bool = False
) -> tuple[str, ...]:
    """Refuse one temperature, and two where all terms are asked for; else say what two do not tell."""
    span = float(np.ptp(sets.temp_c))
    if span < 1e-3 and recording.run is not None:
        chamber = [r.chamber_c for r in recording.run.segments]
        if max(chamber) - min(chamber) >= LEAST_TEMPERATURE_SPAN_C:
            raise DataError(
                f"{recording.source}: the gyro's temperature is stuck at {sets.temp_c[0]:.2f} °C while the chamber "
                f"went from {min(chamber):.0f} to {max(chamber):.0f} °C. Repair the sensor and record again."
            )
    if span < LEAST_TEMPERATURE_SPAN_C:
        within = " to ".join(dict.fromkeys(f"{edge:.2f}" for edge in (sets.temp_c.min(), sets.temp_c.max())))
        raise DataError(
            f"{recording.source}: every data set is at one temperature ({within} °C), which carries no {what} over temperature. "
            f"Record at least {TEMPERATURE_ORDER + 1} temperatures, spread over the range of use."
        )
    if determined_order(sets.temp_c) == TEMPERATURE_ORDER:
        return ()
    said = (
        f"all data sets lie at two temperatures (about {sets.temp_c.min():.1f} and {sets.temp_c.max():.1f} °C), which tell a straight "
        "line over temperature and no bend between them: record at least one temperature more for terms of order "
        f"{TEMPERATURE_ORDER}"
    )
    if paper:
        raise DataError(f"{recording.source}: {said}. Leave out --paper, which asks for them all the same.")
    return (said,)


def _doubts(recording: Recording, sets: DataSets, force: bool) -> tuple[str, ...]:
    saturated = set(recording.sets.segment[recording.saturated].tolist())
    at_rail = [row for row in range(len(sets)) if int(sets.segment[row]) in saturated]
    stuck_sets = (sets.gyro_std_dps == 0) & (sets.n > 1) & (sets.rate_dps != 0)
    stuck = [row for row in np.flatnonzero(stuck_sets).tolist() if row not in at_rail]
    doubts = [
        (at_rail, "saturated: samples stand at the recording's extreme value"),
        (stuck, "stuck: every sample has the same value"),
    ]
    notes = []
    for rows, what in doubts:
        if not rows:
            continue
        listed = ", ".join(sets.describe(row) for row in rows[:_LISTED]) + (
            ", ..." if len(rows) > _LISTED else ""
        )
        are = plural(len(rows), "data [set is|sets are]")
        if not force:
            ids = ",".join(str(sets.segment[row]) for row in rows)
            raise DataError(
                f"{recording.source}: {len(rows)} {are} {what} ({listed}). "
                f"Leave {plural(len(rows), '[it|them]')} out with --exclude {ids}, or say --force."
            )
        notes.append(f"{len(rows)} {are} {what} ({listed}); used because of --force")
    zero = (sets.gyro_std_dps == 0) & (sets.n > 1) & (sets.rate_dps == 0)
    if zero.any():
        count = int(zero.sum())
        where = plural(count, f"{count} data [set|sets]")
        notes.append(f"at rest the output does not move in {where} (coarse steps or a dead zone)")
    return tuple(notes)


def _check_unit(recording: Recording, sets: DataSets, force: bool) -> tuple[str, ...]:
    """Refuse a value that nothing measured, and columns that are not what they say."""
    copied = copies(sets.rate_dps, sets.gyro_dps, sets.temp_c, sets.t_s)
    table = recording.run is None
    odds = odd_columns(sets.rate_dps, sets.gyro_dps, sets.temp_c, copied, sets.segment, lines=table)
    odds = odds or tuple(filter(None, [odd_rates(sets.rate_dps)]))
    if odds and not force:
        raise DataError(f"{recording.source}: {odds[0].what}. {odds[0].remedy}, or say --force.")
    row = gross_row(sets.rate_dps, sets.gyro_dps)
    if row is not None and not force:
        raise DataError(
            f"{recording.source}: {sets.describe(row)} says {sets.gyro_dps[row]:.6g} deg/s, which no gyro does. "
            f"Repair the row, leave it out with --exclude {sets.segment[row]}, or say --force."
        )
    said = [f"{odd.what}; used because of --force" for odd in odds]
    return tuple(said) if odds or not copied else (copied_text(copied, len(sets)),)


def no_rate_text(count: int, rate_dps: float, temp_c: float) -> str:
    """What it means that so many data sets have no rate by a surface, the first at this rate and temperature; no full stop."""
    return (
        f"{count} data {plural(count, '[set has|sets have]')} an output that no rate gives (the first at {rate_dps:+.4g} deg/s, "
        f"{temp_c:.1f} °C): the output stands still or falls while the rate grows, as of a clipped gyro or one beyond its range, or "
        "bends more than a cubic, as an open loop's"
    )


def check_bias(recording: Recording, sets: DataSets) -> tuple[str, ...]:
    """Refuse data that cannot carry a bias over temperature; notes as `check_surface`.

    Raises
    ------
    DataError
        More than one rate and none of them zero, or too few data sets or temperatures.
    """
    if len(sets) <= TEMPERATURE_ORDER + 1:
        raise DataError(
            f"{recording.source}: {len(sets)} data sets at one rate are too few for a bias of order "
            f"{TEMPERATURE_ORDER} in temperature. Record at least {TEMPERATURE_ORDER + 2}, spread over temperature; what a "
            f"record at rest says of noise and bias is gyrocal noise {recording.source}."
        )
    return _check_temperatures(recording, sets, "bias")


def check_rounding(recording: Recording, fit: SurfaceFit, *, force: bool = False) -> tuple[str, ...]:
    """Weigh what whole-degree temperatures do to the fit.

    Rounding to 1 °C is an error of 0.29 °C rms, which the slope of the surface turns into deg/s. Where that is more
    than twice the residual the temperatures cannot be rounded: they are exact, or nominal.
    """
    if not recording.whole_degrees:
        return ()
    half = 0.5
    g, t = fit.sets.gyro_dps, fit.sets.temp_c
    slope = fit.surface.error_dps(g, t + half) - fit.surface.error_dps(g, t - half)
    effect, residual = rms(slope) / np.sqrt(12.0), rms(fit.residual_dps)
    text = f"temperatures are whole degrees: rounding makes {effect:.2g} deg/s rms, the residual is {residual:.2g} deg/s"
    if _ROUNDING_SHARE * residual < effect < 2.0 * residual and not force:
        raise DataError(
            f"{recording.source}: {text}. Log the gyro's temperature with 0.1 °C or finer, or say --force."
        )
    return (text,)
