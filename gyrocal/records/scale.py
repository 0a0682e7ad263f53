"""Whether columns are what they say: an output in another unit or of another sign, a stuck gyro, a copy, a slip of the pen, kelvin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.exchanged import exchanged_text

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: An output that follows the rate by more than this factor, or less than its inverse, is in another unit.
WORST_SCALE = 1.5
#: A scale that is this near to a well-known mistake is that mistake.
_NEAR = 0.15
#: Beyond so many times the rate, an output may be counts as well as of a finer unit.
_COUNTS = 10.0
#: An output that follows the rate by less does not follow it.
_DEAD = 2e-3
#: A data set that is further off than this many times the largest rate was not measured.
_GROSS = 10.0
#: A data set that is off the others' line by more than this share of the largest rate, and so many times what nine in ten are
#: off at most, belongs to another rate.
_STRAY_SHARE, _STRAY_TIMES, _MOST_STRAY = 0.02, 20.0, 0.1
#: Scale to the mistake that makes it, of two that are near to each other the commoner one first.
_MISTAKES = (
    (np.pi / 180.0, "it is in rad/s"),
    (180.0 / np.pi, "the rate is in rad/s"),
    (-1.0, "the sign of the output, or that of the rate, is inverted"),
    (-np.pi / 180.0, "it is in rad/s and of inverted sign"),
    (0.5, "half of the rate: a wrong scale, or a sample rate off by two"),
    (2.0, "twice the rate: a wrong scale, or a sample rate off by two"),
    (3600.0, "it is in deg/h"),
    (1.0 / 3600.0, "the rate is in deg/h"),
    (60.0, "it is in deg/min"),
    (1.0 / 60.0, "the rate is in deg/min"),
    (1e3, "it is in mdeg/s"),
    (1e-3, "the rate is in mdeg/s"),
    (1.0 / 360.0, "it is in rev/s"),
    (360.0, "the rate is in rev/s"),
    (1.0 / 6.0, "it is in rpm"),
    (6.0, "the rate is in rpm"),
)
#: Those that a part of a recording may hold beside rows that are right: half and twice are too near to what a gyro may do, and
#: so is a sixth where a factor is told roughly, as of one that is clipped.
_PART_MISTAKES = tuple((times, what) for times, what in _MISTAKES if not 0.1 < times < 10.0)
_EXACT_MISTAKES = tuple(
    (times, what) for times, what in _MISTAKES if times > 0.0 and not 1.0 / 3.0 < times < 3.0
)
#: Where the rate is less than this share of the largest, a bias or a dead band makes any ratio.
_FAST_SHARE = 0.25
#: A part in another unit is so many data sets, one after another; so much of what a part says goes with what is true; and so
#: many of all rows are right or in a part: where a wheel counts backwards some are as far off as a unit by chance.
_FEWEST_IN_PART, _SHARED, _ALL_BUT = 4, 0.7, 0.8
#: A few rows are in another unit where, read in it, they are off the others' line by no more than so many times what one in two
#: is off, while as they stand they are off by so many times more; at so many rates one after another, for one may lie there by chance.
_SPREAD_TIMES, _OFF_TIMES, _FEWEST_EXACT = 6.0, 10.0, 2
#: Digits that tables are written with, as a share of the largest rate: no closer can a row follow the others.
_DIGITS_SHARE = 1e-6
#: An output is clipped where rows within this share of its range from its end have rates over a range so many times as wide,
#: and nearly all faster ones are among them.
_RAIL_SHARE, _RAIL_TIMES = 0.005, 6.0
#: At one rate it is where so many rows spread by less than this share of what those of the next slower rate do, which the
#: temperature moves, and lie no farther from these than this share of what the scale factor says.
_FEWEST_AT_END, _STILL, _SHORT = 4, 0.1, 0.95
#: Parts that a sentence lists.
_LISTED = 3


#: Rates of a plan are round: multiples of half a unit of their second digit, kept to this share of themselves.
_KEPT = 1e-4
#: Rates nearer to each other than this share are one, and those below this share of the largest are rest.
_ONE_RATE, _REST_SHARE = 1e-3, 1e-3
#: Rates of no plan are that round by chance in fewer recordings than this.
_ROUND_BY_CHANCE = 1e-5
#: Nobody turns a gyro faster, deg/s.
_FASTEST_PLAN_DPS = 2000.0
#: Decimals that tables are written with at most.
_MOST_DECIMALS = 9
#: No gyro works where it is colder or hotter; thermometers that broke say so.
_COLDEST_C, _HOTTEST_C = -100.0, 200.0
#: Coarse steps make rows equal by chance, as a tenth of one made-up table; where so many are, they were entered twice.
_MOST_COPIES = 0.5
#: What to do about a gyro that says one number.
STUCK = "Check the gyro's power, its cable and the column, and record again"
_KELVIN = "Convert them if they are in kelvin, or repair the thermometer's readings"
_COPIED = "Check that the column of the output is not a copy of that of the rate"
_CONVERT = (
    "Rates are deg/s, counter-clockwise positive; for counts the nominal scale and its sign are given with "
    "--counts-per-dps. Convert the output"
)
_CONVERT_PART = (
    "Write them as the others (deg/s, counter-clockwise positive), with what stands beside them at slow rates, which do not "
    "tell, or leave them out"
)


class Part(NamedTuple):
    """Rows in which what is told is `times` what is true, as by the mistake `meaning`, while other rows are right."""

    rows: Ints
    times: float
    meaning: str


class Odd(NamedTuple):
    """What is wrong, and what to do; neither ends with a full stop. A wrong scale may be what coefficients correct."""

    what: str
    remedy: str
    a_scale: bool = False


def output_scale(rate_dps: Floats, gyro_dps: Floats) -> float:
    """Slope of output over rate, (deg/s)/(deg/s): the median over pairs of rows half the record apart in rate.

    A bias, or some wild values, do not move it. NaN where there is one rate only.
    """
    order = np.argsort(rate_dps, kind="stable")
    rate, gyro = rate_dps[order], gyro_dps[order]
    half = rate.size // 2
    step = rate[half:] - rate[: rate.size - half]
    apart = step > 1e-9
    if half == 0 or not apart.any():
        return float("nan")
    return float(np.median((gyro[half:] - gyro[: rate.size - half])[apart] / step[apart]))


def unclipped(rate_dps: Floats, gyro_dps: Floats, temp_c: Floats | None = None) -> NDArray[np.bool_]:
    """Rows whose output is at neither end of its range; all where the output does not stand still there while the rate grows.

    Parameters
    ----------
    temp_c : of data sets
        With it the output is also asked whether it stands still at the largest rate alone, while the temperature changes.
    """
    within, rates = _RAIL_SHARE * float(np.ptp(gyro_dps)), float(np.ptp(rate_dps))
    free = np.ones(rate_dps.size, dtype=np.bool_)
    for end in (float(gyro_dps.min()), float(gyro_dps.max())):
        rail = np.abs(gyro_dps - end) <= within
        slow, fast = np.min(np.abs(rate_dps[rail])), np.max(np.abs(rate_dps[rail]))
        if _of_one_sign(rate_dps[rail]) and fast - slow > _RAIL_TIMES * _RAIL_SHARE * rates:
            faster = rate_dps * np.sign(rate_dps[rail][0]) > slow
            free &= ~rail if np.mean(rail[faster]) > _ALL_BUT else True
    if temp_c is not None:
        for side in (1.0, -1.0):
            free &= ~_still_at_last_rate(side * rate_dps, side * gyro_dps, temp_c)
    return free


def _of_one_sign(rate_dps: Floats) -> bool:
    return bool(np.all(rate_dps > 0.0) or np.all(rate_dps < 0.0))


def _still_at_last_rate(rate_dps: Floats, gyro_dps: Floats, temp_c: Floats) -> NDArray[np.bool_]:
    """Rows of the largest rate where their output alone stands still, though their temperature changes as that of others."""
    last = rate_dps > (1.0 - _ONE_RATE) * rate_dps.max()
    slower = rate_dps[~last].max(initial=-np.inf)
    before = ~last & (rate_dps > (1.0 - _ONE_RATE) * slower) & (slower > 0.0)
    none = np.zeros(rate_dps.size, dtype=np.bool_)
    if min(np.sum(last), np.sum(before)) < _FEWEST_AT_END:
        return none
    as_warm = np.ptp(temp_c[last]) > 0.5 * np.ptp(temp_c[before])
    still = as_warm and np.ptp(gyro_dps[last]) < _STILL * np.ptp(gyro_dps[before])
    grown = np.mean(gyro_dps[last]) - np.mean(gyro_dps[before])
    turned = np.mean(rate_dps[last]) - np.mean(rate_dps[before])
    short = grown < _SHORT * output_scale(rate_dps, gyro_dps) * turned
    return last if still and short else none


def scale_unclipped(rate_dps: Floats, gyro_dps: Floats) -> float:
    """`output_scale` of the rows whose output is not clipped: a gyro beyond its range is in no other unit."""
    free = unclipped(rate_dps, gyro_dps)
    return output_scale(rate_dps[free], gyro_dps[free])


def stray_rows(rate_dps: Floats, gyro_dps: Floats, most: float = _MOST_STRAY) -> NDArray[np.int64]:
    """Rows that are off the straight line of the others by a share of the largest rate that no nonlinearity has beside them.

    Rates that were mixed up, mostly. None where more than the share `most` are: where that is a tenth, it is the gyro that
    does it. More may be looked for where no surface follows them.
    """
    scale, largest = output_scale(rate_dps, gyro_dps), float(np.max(np.abs(rate_dps), initial=0.0))
    if not np.isfinite(scale):
        return np.empty(0, dtype=np.int64)
    off = gyro_dps - scale * rate_dps
    off = np.abs(off - np.median(off))
    usual = float(np.quantile(off, 1.0 - most))
    return np.flatnonzero((off > _STRAY_SHARE * largest) & (off > _STRAY_TIMES * usual))


def gross_row(rate_dps: Floats, gyro_dps: Floats) -> int | None:
    """The row that is furthest off the straight line, where no gyro and no table is that wrong; else None."""
    scale, largest = output_scale(rate_dps, gyro_dps), float(np.max(np.abs(rate_dps), initial=0.0))
    if not np.isfinite(scale) or largest == 0.0:
        return None
    off = gyro_dps - scale * rate_dps
    off = np.abs(off - np.median(off))
    row = int(np.argmax(off))
    return row if off[row] > _GROSS * largest * max(1.0, abs(scale)) else None


def copies(rate_dps: Floats, gyro_dps: Floats, temp_c: Floats, t_s: Floats | None = None) -> int:
    """Rows that repeat an earlier one to the last digit; none of a record at one rate, whose steps are coarse.

    Of other times a row is another measurement, which coarse steps make equal by chance: unless so many are.
    """
    if np.ptp(rate_dps) == 0:
        return 0
    rows = np.column_stack([rate_dps, gyro_dps, temp_c])
    count = _repeated(rows)
    if t_s is None or not np.isfinite(t_s).all() or count >= _MOST_COPIES * rate_dps.size:
        return count
    return _repeated(np.column_stack([rows, t_s]))


def _repeated(rows: Floats) -> int:
    return int(len(rows) - np.unique(rows, axis=0).shape[0])


def copied_text(count: int, rows: int) -> str:
    """That some rows are copies, without a full stop."""
    return (
        f"{count} of {rows} data sets repeat an earlier one to the last digit of rate, output and temperature, and "
        "make every interval too narrow if they were entered twice"
    )


def parts_in_other_units(
    true: Floats,
    told: Floats,
    number: Ints,
    mistakes: Sequence[tuple[float, str]],
    *,
    fewest: int,
    within: float,
) -> tuple[Part, ...]:
    """Stretches of consecutive rows in which a column is in another unit than elsewhere, whatever the gyro errs by.

    Parameters
    ----------
    true, told : ndarray, shape (n,)
        What was to be measured, and what the column says.
    number : ndarray of int, shape (n,)
        Data set of each row, of which a part has at least `fewest`: rows of one do not vouch for each other.
    mistakes : sequence of (factor, meaning)
        Another unit is one of these factors.
    within : float
        What the gyro, or wheels that slip, may be off by beside the unit, as a factor.
    """
    size, said = np.abs(true), np.abs(told)
    large = (size > _FAST_SHARE * size.max(initial=0.0)) | (said > _FAST_SHARE * said.max(initial=0.0))
    fast = np.flatnonzero(large & (true * told != 0.0))
    ratio = told[fast] / true[fast]
    factors = np.array([1.0, *(times for times, _ in mistakes)])
    off = np.abs(np.log(np.abs(ratio[:, None] / factors)))
    off[ratio[:, None] * factors < 0.0] = np.inf
    # Factors lie closer together than a gyro may bend: where one is that of all rows, nothing changes.
    if np.any(off.max(axis=0, initial=0.0) < np.log(within)):
        return ()
    kind = np.where(off.min(axis=1) < np.log(within), off.argmin(axis=1), -1)
    found: list[tuple[int, Ints]] = []
    for rows in _alike(kind):
        which, a, b = int(kind[rows[0]]), true[fast[rows]], told[fast[rows]]
        together = abs(a @ b) > _SHARED * np.sqrt((a @ a) * (b @ b))
        if which < 0 or not together or np.unique(number[fast[rows]]).size < fewest:
            continue
        before = found.pop()[1] if found and found[-1][0] == which else rows[:0]
        found.append((which, np.concatenate([before, rows])))
    kinds = {which for which, _ in found}
    if len(kinds) < 2 or np.count_nonzero(np.isin(kind, list(kinds))) < _ALL_BUT * kind.size:
        return ()
    return tuple(
        Part(fast[rows], float(np.median(ratio[rows])), mistakes[which - 1][1])
        for which, rows in found
        if which > 0
    )


def few_in_other_units(rate_dps: Floats, gyro_dps: Floats) -> tuple[Part, ...]:
    """Stretches of few consecutive rows that are in another unit to within the spread of the others."""
    free = unclipped(rate_dps, gyro_dps)
    scale = output_scale(rate_dps[free], gyro_dps[free])
    if not np.isfinite(scale):
        return ()
    bias = float(np.median((gyro_dps - scale * rate_dps)[free]))
    as_told = np.abs(gyro_dps - scale * rate_dps - bias)
    usual = max(float(np.median(as_told[free])), _DIGITS_SHARE * float(np.median(np.abs(rate_dps))))
    near, far = _SPREAD_TIMES * usual, _OFF_TIMES * _SPREAD_TIMES * usual
    times = np.array([factor for factor, _ in _EXACT_MISTAKES])
    of_rate = np.array([meaning.startswith("the rate") for _, meaning in _EXACT_MISTAKES])
    # Read in the unit of each mistake, which is one of the rate, or of the output; a rate near zero then tells nothing.
    on_line = scale * np.where(of_rate, times, 1.0) * rate_dps[:, None]
    in_unit = np.abs(gyro_dps[:, None] / np.where(of_rate, 1.0, times) - on_line - bias)
    in_unit[np.abs(on_line) <= far] = np.inf
    other = (in_unit.min(axis=1) < near) & (as_told > far)
    tells = np.flatnonzero(other | ((as_told < near) & (np.abs(scale * rate_dps) > far)))
    kind = np.where(other, in_unit.argmin(axis=1), -1)[tells]
    return tuple(
        Part(
            tells[rows],
            float(np.median(gyro_dps[tells[rows]] / rate_dps[tells[rows]])),
            _EXACT_MISTAKES[kind[rows[0]]][1],
        )
        for rows in _alike(kind)
        if kind[rows[0]] >= 0 and np.unique(np.abs(rate_dps[tells[rows]])).size >= _FEWEST_EXACT
    )


def _alike(kind: Ints) -> list[Ints]:
    """Stretches of consecutive rows of one kind."""
    rows = np.arange(kind.size)
    return [part for part in np.split(rows, np.flatnonzero(np.diff(kind)) + 1) if part.size]


def times_said(times: float) -> str:
    """A factor in a sentence."""
    return f"{times:,.0f}" if abs(times) >= 100.0 else f"{times:.3g}"


def odd_part(rate_dps: Floats, gyro_dps: Floats, temp_c: Floats, number: Ints, *, lines: bool) -> Odd | None:
    """What is wrong with an output that changes its unit or sign within the recording; None if it does not.

    Parameters as in `odd_columns`. A part is a stretch of time, or of temperature.
    """
    if np.ptp(rate_dps) == 0.0:
        return None
    for by_time, order in (
        (True, np.arange(rate_dps.size)),
        (False, np.argsort(temp_c, kind="stable")),
    ):
        columns = rate_dps[order], gyro_dps[order], number[order]
        parts = parts_in_other_units(
            *columns, _PART_MISTAKES, fewest=_FEWEST_IN_PART, within=WORST_SCALE
        ) or few_in_other_units(*columns[:2])
        if parts:
            said = [
                f"{_where(number[rows], temp_c[rows], by_time=by_time, lines=lines)} the output is {times_said(part.times)} times the rate ({part.meaning})"
                for part in parts[:_LISTED]
                for rows in (order[part.rows],)
            ]
            more = f", and so on {len(parts) - _LISTED} times" if len(parts) > _LISTED else ""
            return Odd(
                f"{'; '.join(said)}{more}, and elsewhere it is not: unit or sign change within the recording",
                _CONVERT_PART,
            )
    return None


def _where(number: Ints, temp_c: Floats, *, by_time: bool, lines: bool) -> str:
    """Where a part is: from which data set to which, or at which temperatures."""
    first, last = int(number.min()), int(number.max())
    span = " to ".join(dict.fromkeys(f"{edge:.1f}" for edge in (temp_c.min(), temp_c.max()))) + " °C"
    if by_time:
        of_file = f"lines {first + 1} to {last + 1}, " if lines else ""
        return f"in data sets {first} to {last} ({of_file}{span})"
    of_file = f", on line {first + 1}" if lines else ""
    return f"in {np.unique(number).size} data sets at {span} (the first is {first}{of_file})"


def odd_columns(
    rate_dps: Floats,
    gyro_dps: Floats,
    temp_c: Floats,
    copied: int,
    number: Ints,
    *,
    lines: bool,
    ideal: bool = False,
) -> tuple[Odd, ...]:
    """All that is wrong with the columns of a recording, whoever asks.

    Parameters
    ----------
    copied : int
        Rows that are `copies` of earlier ones.
    number : ndarray of int
        Number of the data set that each row belongs to, from 1.
    lines : bool
        Whether the data sets are lines of a table, the first on line 2.
    ideal : bool
        Whether it is a simulation, whose output may be the rate itself and repeats where the rate does.
    """
    twice = not ideal and copied >= _MOST_COPIES * rate_dps.size
    return tuple(
        filter(
            None,
            (
                Odd(copied_text(copied, rate_dps.size), "Remove the copies") if twice else None,
                odd_order(rate_dps, gyro_dps) if lines else None,
                odd_part(rate_dps, gyro_dps, temp_c, number, lines=lines)
                or odd_output(rate_dps, gyro_dps, ideal=ideal),
                odd_temperature(temp_c),
            ),
        )
    )


def odd_order(rate_dps: Floats, gyro_dps: Floats) -> Odd | None:
    """Rate and output of a table in each other's place; else None."""
    text = exchanged_text(rate_dps, gyro_dps)
    return Odd(text, "Put the table's rate in rate_dps and the gyro's output in gyro_dps") if text else None


def odd_temperature(temp_c: Floats) -> Odd | None:
    """What is wrong with temperatures that no gyro has; None if they can be one's."""
    low_c, high_c = float(np.min(temp_c)), float(np.max(temp_c))
    if low_c >= _COLDEST_C and high_c <= _HOTTEST_C:
        return None
    much = "hot" if high_c > _HOTTEST_C else "cold"
    return Odd(f"temperatures run from {low_c:.4g} to {high_c:.4g} °C, and no gyro works so {much}", _KELVIN)


def odd_rates(rate_dps: Floats) -> Odd | None:
    """Rates in rad/s, with an output that follows them: they are round in deg/s and not as they stand; else None.

    Multiples of one odd rate are round together by chance: of 200,000 made-up plans in deg/s, most of them of odd rates, 315
    were refused.
    """
    times, largest = 180.0 / np.pi, float(np.max(np.abs(rate_dps)))
    if not 0.0 < largest * times < _FASTEST_PLAN_DPS:
        return None
    if (
        round_by_chance(rate_dps, times) > _ROUND_BY_CHANCE
        or round_by_chance(rate_dps, 1.0) <= _ROUND_BY_CHANCE
    ):
        return None
    return Odd(
        f"the rates are round numbers of deg/s once they are multiplied by 180/pi, and not as they stand (the largest, {largest:.6g}, "
        f"is then {largest * times:.6g}): rate and output seem to be in rad/s",
        "Convert both to deg/s, and what else stands in rad/s",
    )


def round_by_chance(rate_dps: Floats, factor: float) -> float:
    """How probable it is that arbitrary rates are as round as these are, multiplied by a factor; 1 where one of them is not."""
    sizes = np.sort(np.abs(rate_dps))
    sizes = sizes[sizes > _REST_SHARE * sizes[-1]]
    if not sizes.size:
        return 1.0
    starts = np.flatnonzero(np.diff(sizes, prepend=0.0) > _ONE_RATE * sizes)
    mean = np.add.reduceat(sizes, starts) / np.diff(np.append(starts, sizes.size)) * factor
    decimals = next(
        (
            k
            for k in range(_MOST_DECIMALS)
            if np.allclose(rate_dps, np.round(rate_dps, k), rtol=0.0, atol=1e-12)
        ),
        _MOST_DECIMALS,
    )
    kept = np.maximum(_KEPT * mean, 0.5 * factor * 10.0**-decimals)
    unit = 0.5 * 10.0 ** (np.floor(np.log10(mean) + _KEPT) - 1.0)
    if np.any(np.abs(mean - unit * np.round(mean / unit)) > kept):
        return 1.0
    return float(np.prod(np.minimum(2.0 * kept / unit, 1.0)))


def odd_output(rate_dps: Floats, gyro_dps: Floats, *, ideal: bool = False) -> Odd | None:
    """What is wrong with an output that does not follow the rate as a gyro's does; None if it does.

    `ideal`: it may be the rate itself, as that of a simulated gyro without errors.
    """
    if gyro_dps.size > 1 and float(np.ptp(gyro_dps)) == 0.0:
        return Odd(f"the gyro says {gyro_dps[0]:.6g} in every row: it is stuck", STUCK)
    if not ideal and np.array_equal(rate_dps, gyro_dps):
        return Odd("the gyro says exactly the rate in every row, which no gyro does", _COPIED)
    scale = scale_unclipped(rate_dps, gyro_dps)
    if not np.isfinite(scale) or 1.0 / WORST_SCALE < scale < WORST_SCALE:
        return None
    text = f"the output is {times_said(scale)} times the rate"
    off = [abs(scale / times - 1.0) for times, _ in _MISTAKES]
    nearest = int(np.argmin(off))
    if off[nearest] < _NEAR:
        # The commoner ones stand first: rad/s of a gyro that is 5 % off are as near to deg/min.
        meaning = ", or ".join(
            what for (_, what), far in zip(_MISTAKES[: nearest + 1], off, strict=False) if far < _NEAR
        )
        meaning += ", or in counts of another scale" * (scale >= _COUNTS)
        return Odd(f"{text} ({meaning}), which is another unit or sign", _CONVERT, a_scale=True)
    if abs(scale) < _DEAD:
        return Odd(f"{text}: it does not follow the rate", STUCK, a_scale=True)
    return Odd(f"{text}, which is another unit or sign", _CONVERT, a_scale=True)
