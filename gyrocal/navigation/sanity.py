"""Mix-ups that no dead reckoning explains: a unit that changes within a log, and by a truth another unit, radians, a mirror."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.align import align_positions, wrapped_deg
from gyrocal.records.scale import parts_in_other_units, times_said
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Units that positions come in by mistake, in metres.
UNITS = {1e-3: "millimetres", 1e3: "kilometres"}
#: Stretches of a path whose lengths tell the truth's unit.
_STRETCHES = 50
#: A factor this near to that of a wrong unit is one; dead reckoning is never off by so much.
_UNIT_FACTOR = 3.0
#: Windows of a path, by its way, in which truth and path are laid on each other; a window counts where they share so much
#: of their shapes, and so many are asked for: what is left of a gyro's drift within one, or a truth of much noise, says nothing.
_WINDOWS, _SHARED, _FEWEST = 8, 0.9, 4
#: No wheel is off by such a factor, and none that skids goes on driving: the way has another unit.
_WAY_FACTOR = 1.5
#: A degree of latitude is 111 km.
_DEGREES = 3e-5
#: A heading goes with the course of its own positions by so much (the length of a mean of unit vectors); along one straight
#: line clockwise and counter-clockwise look alike.
_GOES_WITH, _GOES_AGAINST = 0.8, 0.5
#: A robot that slips sideways, or turns about its front, is not so far off its heading in the mean of a drive.
_TURNED_BY_DEG = 30.0
#: A mirrored truth fits this much better in a mirror than as it stands, and as it stands misses by this share of the
#: path's extent: a straight path, which is its own mirror image, does neither. A path by a gyro in radians fits as much better
#: once its turns are made larger, and misses a window with a corner by this share of its extent.
_BETTER_IN_MIRROR, _MISSES, _MISSES_A_CORNER = 0.25, 0.2, 0.05
#: A part of a log in another unit is so many windows of this length, one after another, in which the robot turns, or goes;
#: in each the channels may be apart by this factor beside their unit, as wheels slip (0.58 to 1.49 on 47 sound logs).
_PART_S, _PART_WINDOWS, _PART_WITHIN = 2.5, 3, 2.0
#: What a turn may be of another channel's by mistake, and a truth's way of the wheels'.
_TURN_MISTAKES = (
    (DEG_TO_RAD, "radians for degrees"),
    (RAD_TO_DEG, "degrees converted twice"),
    (3600.0, "deg/h for deg/s"),
    (1e3, "mdeg/s for deg/s"),
    (-1.0, "the other sign, or left for right"),
)
_WAY_MISTAKES = (
    (1e3, "millimetres for metres"),
    (1e2, "centimetres for metres"),
    (1e-3, "kilometres for metres"),
)
#: A window counts where one of the channels turns so far, deg, and where the robot goes by this share of the longest: of a
#: robot that drives straight on, or stands, the channels tell their noise (9 deg within 5 s, on a made-up drive).
_TURNS_DEG, _GOES = 10.0, 0.25
#: Turned less than this in all, headings in degrees and radians look alike.
_TURNED_DEG = 60.0


def turn_part_fault(t_s: Floats, true_deg: Floats, told_deg: Floats, names: tuple[str, str]) -> str | None:
    """What is wrong with turns that are in another unit, or of another sign, in a part of a log only; None where nothing is.

    Parameters
    ----------
    t_s, true_deg, told_deg : ndarray, shape (n,)
        Time, and what two channels have turned by since the start.
    names : tuple of str
        Of the two channels, for the sentence.
    """
    edges_s = np.arange(t_s[0], t_s[-1], _PART_S)
    true, told = (np.diff(np.interp(edges_s, t_s, angle)) for angle in (true_deg, told_deg))
    turns = np.maximum(np.abs(true), np.abs(told)) > _TURNS_DEG
    return _part_fault(edges_s[:-1][turns], true[turns], told[turns], _TURN_MISTAKES, (*names, "turns"))


def truth_part_fault(t_s: Floats, path: Floats, truth: Floats) -> str | None:
    """What is wrong with a truth, or with what it tells of wheels and gyro, in a part of a log only; arrays as in `truth_fault`."""
    known = np.isfinite(truth[:, 2])
    if np.count_nonzero(known) > 1:
        turned_deg = np.unwrap(truth[known, 2], period=360.0)
        fault = turn_part_fault(t_s[known], path[known, 2], turned_deg, ("the gyro", "truth_heading_deg"))
        if fault is not None:
            return fault
    known = np.isfinite(truth[:, 0] + truth[:, 1])
    if np.count_nonzero(known) < _FEWEST:
        return None
    edges_s = np.arange(t_s[known][0], t_s[known][-1], _PART_S)
    own, told = (
        np.hypot(*(np.diff(np.interp(edges_s, t_s[known], column)) for column in points[known, :2].T))
        for points in (path, truth)
    )
    goes = own > _GOES * own.max(initial=0.0)
    return _part_fault(
        edges_s[:-1][goes], own[goes], told[goes], _WAY_MISTAKES, ("the wheels", "the truth", "goes")
    )


def _part_fault(
    start_s: Floats,
    true: Floats,
    told: Floats,
    mistakes: tuple[tuple[float, str], ...],
    names: tuple[str, str, str],
) -> str | None:
    """Which windows of a log are in another unit, in words; `names`: of the true channel, of the other, and what it does."""
    parts = parts_in_other_units(
        true, told, np.arange(true.size), mistakes, fewest=_PART_WINDOWS, within=_PART_WITHIN
    )
    if not parts:
        return None
    other, name, does = names
    said = [
        f"from t_s = {start_s[part.rows[0]]:.0f} to {start_s[part.rows[-1]] + _PART_S:.0f} {name} {does} "
        f"{times_said(part.times)} times as far as {other} ({part.meaning})"
        for part in parts
    ]
    return (
        f"{'; '.join(said)}, and elsewhere not: a unit or sign changes within the log. Write these rows as the others, or cut "
        "the log there."
    )


def truth_fault(path: Floats, truth: Floats) -> str | None:
    """What is wrong with a truth, in words, and what to do; None where nothing is.

    Parameters
    ----------
    path, truth : ndarray, shape (n, 3)
        x and y in m and heading in deg at the same rows, dead reckoning and truth; NaN where the truth has none.
    """
    known = np.isfinite(truth[:, 0] + truth[:, 1])
    own, told = path[known, :2], truth[known, :2]
    if own.shape[0] < 10:
        return _heading_fault(path, truth)
    fault = degrees_fault(own, told) or gyro_fault(path[known], truth[known])
    if fault is not None:
        return fault
    unit_m = truth_unit_m(own, told)
    if unit_m != 1.0:
        return f"the truth's positions are {1.0 / unit_m:g} times the path's: they are in {UNITS[unit_m]}. State their unit in a mapping with --columns."
    if in_radians(path[:, 2], truth[:, 2]):
        return RADIANS
    fault = way_fault(own, told) or mirror_fault(own, told) or (CLOCKWISE if clockwise(path, truth) else None)
    return fault or backwards_fault(path, truth) or heading_fault(path, truth)


RADIANS = (
    "the truth's heading is in radians. Write it in degrees, or state its unit in a mapping with --columns."
)
AGAINST_GYRO = "the truth's heading and the gyro turn against each other: the heading is a compass's, clockwise, or the gyro's sign is inverted. State the sign of the one that is wrong in a mapping with --columns."


def _heading_fault(path: Floats, truth: Floats) -> str | None:
    """What is wrong with a truth of headings alone; arrays as in `truth_fault`."""
    own_deg, told = path[:, 2], truth[:, 2]
    if not np.isfinite(told).any():
        return None
    if in_radians(own_deg, told):
        return RADIANS
    return gyro_fault(path, truth) or (AGAINST_GYRO if turns_against(own_deg, told) else None)


def way_fault(own: Floats, told: Floats) -> str | None:
    """What is wrong with a way that is too long or too short for any wheel; None where nothing is.

    Parameters
    ----------
    own, told : ndarray, shape (n, 2)
        Positions of dead reckoning and of the truth at the same rows, m.
    """
    window = _windows(own)
    factors = []
    for k in range(_WINDOWS):
        a, b = ((p[:, 0] + 1j * p[:, 1])[window == k] for p in (own, told))
        if a.size < 3:
            continue
        a, b = a - a.mean(), b - b.mean()
        # An inverted gyro makes a mirror image as long as the path.
        both = max(abs(np.vdot(a, b)), abs(np.vdot(np.conj(a), b)))
        saa, sbb = float(np.vdot(a, a).real), float(np.vdot(b, b).real)
        if both > 0.0 and both**2 > _SHARED * saa * sbb:
            factors.append(both / saa)
    factor = float(np.median(factors)) if len(factors) >= _FEWEST else 1.0
    if 1.0 / _WAY_FACTOR < factor < _WAY_FACTOR:
        return None
    return f"by the truth the robot goes {factor:.3g} times as far as by its wheels, and no wheel is so far off: the way is in another unit (km/h for m/s makes 0.278), or metres_per_tick is wrong. Correct that, or state the unit in a mapping with --columns."


def degrees_fault(own: Floats, told: Floats) -> str | None:
    """What is wrong with positions in degrees, whose shape differs by the latitude; arrays as in `way_fault`."""
    if not 0.0 < _extent(told) < _DEGREES * _extent(own):
        return None
    return "the truth's positions are degrees of longitude and latitude. Write them in metres to the east and to the north."


def _windows(own: Floats) -> Ints:
    """The window of each position, by the way to it."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(own, axis=0).T))])
    return np.minimum((_WINDOWS * way / max(float(way[-1]), 1e-9)).astype(np.int64), _WINDOWS - 1)


def truth_unit_m(own: Floats, told: Floats) -> float:
    """The truth's unit in metres, by the lengths of stretches: a key of `UNITS`, or 1.

    Parameters
    ----------
    own, told : ndarray, shape (n, 2)
        Positions of dead reckoning, m, and of the truth at the same rows. Only lengths count, so that a heading that
        drifts does no harm.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(own, axis=0).T))])
    if way[-1] <= 0.0:
        return 1.0
    stretch_m = way[-1] / _STRETCHES
    marks = np.searchsorted(way, np.arange(0.0, way[-1], stretch_m))
    a, b = (np.hypot(*np.diff(points[marks], axis=0).T) for points in (own, told))
    moved = a > 0.3 * stretch_m
    ratio = float(np.median(b[moved] / a[moved])) if moved.any() else 0.0
    fits = [unit for unit in UNITS if ratio > 0.0 and abs(np.log(ratio * unit)) < np.log(_UNIT_FACTOR)]
    return fits[0] if fits else 1.0


CLOCKWISE = "the truth's heading turns clockwise, as a compass's does, while its positions turn the other way. Write 90 less it, or state sign = -1 and offset = 90 in a mapping with --columns."


def clockwise(path: Floats, truth: Floats) -> bool:
    """Whether a truth's headings turn against its own positions; arrays as in `truth_fault`, headings in degrees.

    The path only says where the robot backs up, so that a gyro's drift does no harm, nor a truth that is mirrored as a whole.
    """
    mean = _of_course(path, truth)
    return mean is not None and abs(mean.against) > _GOES_WITH and abs(mean.along) < _GOES_AGAINST


def turned_deg(path: Floats, truth: Floats) -> float:
    """By how much a truth's headings are off the course of its own positions, alike all along; 0 where they are not, or by little.

    Arrays as in `truth_fault`. A body that is carried sideways or backwards, or a frame of the truth's own.
    """
    mean = _of_course(path, truth)
    if mean is None or abs(mean.along) < _GOES_WITH or _backwards(mean):
        return 0.0
    off_deg = float(np.degrees(np.angle(mean.along)))
    return -off_deg if abs(off_deg) > _TURNED_BY_DEG else 0.0


def backwards_fault(path: Floats, truth: Floats) -> str | None:
    """What is wrong with wheels by which a robot backs up all along that goes forward by the truth; arrays as in `truth_fault`."""
    mean = _of_course(path, truth)
    if mean is None or not _backwards(mean):
        return None
    return "the wheels run backwards: by its own positions and headings the truth goes forward all along, and by its wheels the robot backs up. State sign = -1 for their way in a mapping with --columns; of two sides for both, and left for right, for they turn as the gyro does; or, if the robot did back up, offset = 180 for the truth's heading, which is its course then."


def _backwards(mean: _Course) -> bool:
    """Whether the truth's headings are the course of its positions as it stands, and against it where the path tells forward from back."""
    turned = np.degrees(np.abs(np.angle([mean.plain, mean.along])))
    goes = min(abs(mean.plain), abs(mean.along)) > _GOES_WITH
    return bool(goes and turned[0] < _TURNED_BY_DEG and turned[1] > 180.0 - _TURNED_BY_DEG)


def heading_fault(path: Floats, truth: Floats) -> str | None:
    """What is wrong with headings that have nothing to do with the course of their own positions, though the path has; arrays as in `truth_fault`."""
    mean = _of_course(path, truth)
    if mean is None or abs(mean.path) < _GOES_WITH or max(abs(mean.along), abs(mean.against)) > _GOES_AGAINST:
        return None
    return "the truth's heading has nothing to do with the course of its own positions, which the path follows: it is another's, or of a quaternion in another order. Correct it, or leave it out."


class _Course(NamedTuple):
    """Means of unit vectors over stretches: the course of a truth's positions less its heading, plus it, and less the path's heading.

    The course is of a robot that backs up where the path does; `plain` is the first without that.
    """

    along: complex
    against: complex
    path: complex
    plain: complex


def _of_course(path: Floats, truth: Floats) -> _Course | None:
    """How a truth's headings go with the course of its positions; None where it has too few of both."""
    known = np.isfinite(truth).all(axis=1)
    if np.count_nonzero(known) < 10:
        return None
    own, told = path[known], truth[known]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(own[:, :2], axis=0).T))])
    marks = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], _STRETCHES + 1)[:-1]))
    if marks.size < _FEWEST:
        return None
    step, seen = (np.diff((p[:, 0] + 1j * p[:, 1])[marks]) for p in (own, told))
    ahead, said = (np.add.reduceat(np.exp(1j * np.radians(p[:, 2])), marks)[:-1] for p in (own, told))
    course = np.angle(seen * np.sign(np.real(step * np.conj(ahead))))
    headings = np.angle(said), -np.angle(said), np.angle(ahead), np.angle(said) + course - np.angle(seen)
    return _Course(*(complex(np.mean(np.exp(1j * (course - heading)))) for heading in headings))


def _extent(points: Floats) -> float:
    return float(np.sqrt(np.sum(np.var(points, axis=0))))


def mirror_fault(own: Floats, told: Floats) -> str | None:
    """What is wrong with a truth that follows the path in a mirror only; arrays as in `way_fault`."""
    misses = [_misfit(own, told), _misfit(own, told * np.array([1.0, -1.0]))]
    if misses[0] < _MISSES * _extent(own) or misses[1] > _BETTER_IN_MIRROR * misses[0]:
        return None
    return f"the truth follows the path in a mirror only (rms {misses[1]:.3g} m, {misses[0]:.3g} m as it stands): its y has the wrong sign, x and y are swapped, or the gyro's sign is inverted. State the signs in a mapping with --columns."


def _misfit(own: Floats, told: Floats) -> float:
    aligned = np.stack(align_positions(own, told).apply(own[:, 0], own[:, 1]), axis=1)
    return float(np.sqrt(np.mean(np.sum((aligned - told) ** 2, axis=1))))


def gyro_fault(path: Floats, truth: Floats) -> str | None:
    """What is wrong with a gyro whose headings turn as the truth's do in radians; None where nothing is.

    By the truth's headings; where it has none, by whether the path fits its positions once it turns so much more.
    Arrays as in `truth_fault`.
    """
    known = np.isfinite(truth[:, 2])
    if known.any():
        radians = in_radians(np.unwrap(truth[known, 2], period=360.0), path[known, 2])
    else:
        radians = _bends_as_in_radians(path, truth[:, :2])
    if not radians:
        return None
    return "by the truth the robot turns 57.3 times as far as by the gyro: gyro_dps is in rad/s. Write it in deg/s, or state its unit in a mapping with --columns."


def _bends_as_in_radians(path: Floats, told: Floats) -> bool:
    """Whether windows of a path follow the truth's positions with turns 57.3 times as large, and miss them as they are."""
    known = np.isfinite(told).all(axis=1)
    own, told = path[known], told[known]
    if own.shape[0] < 10:
        return False
    step = np.diff(own[:, 0] + 1j * own[:, 1])
    heading = np.radians(0.5 * (own[1:, 2] + own[:-1, 2]))
    bent = np.concatenate([[0.0], np.cumsum(step * np.exp(1j * (RAD_TO_DEG - 1.0) * heading))])
    turned = np.column_stack([bent.real, bent.imag])
    window = _windows(own[:, :2])
    votes = 0
    for k in range(_WINDOWS):
        here = window == k
        if np.count_nonzero(here) >= _FEWEST:
            as_it_is, more = (_misfit(points[here], told[here]) for points in (own[:, :2], turned))
            votes += as_it_is > _MISSES_A_CORNER * _extent(told[here]) and more < _BETTER_IN_MIRROR * as_it_is
    return votes >= _FEWEST


def in_radians(own_deg: Floats, told: Floats) -> bool:
    """Whether a truth's headings, NaN where there is none, are in radians, by the turns of dead reckoning."""
    known = np.isfinite(told)
    if np.count_nonzero(known) and float(np.ptp(told[known])) > 0.1 * float(np.ptp(own_deg[known])):
        return False
    return _turns_rather(own_deg, told, RAD_TO_DEG)


def turns_against(own_deg: Floats, told: Floats) -> bool:
    """Whether a truth's headings, NaN where there is none, turn the other way than dead reckoning."""
    return _turns_rather(own_deg, told, -1.0)


def _turns_rather(own_deg: Floats, told: Floats, times: float) -> bool:
    """Whether headings turn as dead reckoning does once they turn so many times as far, and not as they are."""
    known = np.isfinite(told)
    if np.count_nonzero(known) < 10 or float(np.ptp(own_deg[known])) < _TURNED_DEG:
        return False
    turned, said = np.diff(own_deg[known]), np.diff(told[known])
    apart = [float(np.mean(np.abs(wrapped_deg(unit * said - turned)))) for unit in (1.0, times)]
    return apart[1] < 0.5 * apart[0]
