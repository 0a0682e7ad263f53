"""A recording as rows with coordinates: what the tests for missing physics look at.

Rows are means over short bins: short enough that nothing an effect can do is lost (a bin turns the table by at
most `_BIN_TURN_DEG`, the first seconds after a rate step stay sample by sample), long enough that the tests on
hundreds of columns take seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import reduce_segment, reference_rate
from gyrocal.diagnosis.remarks import Note, Remark, Said
from gyrocal.diagnosis.rows.history import TemperatureHistory, temperature_history
from gyrocal.errors import DataError
from gyrocal.inference.rounding import lattice, mean_error
from gyrocal.physics.lacking import Lack, Reason, Why
from gyrocal.records.datasets import switched_on_s
from gyrocal.records.run import Run, Segment
from gyrocal.units import STDS_PER_MAD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: A bin of a data set turns the table by this at most, deg: two cycles a turn keep 98 % of their size, four 92 %.
_BIN_TURN_DEG = 20.0
#: And lasts this long, s; in segments longer than the next it may last as long as the one after, or as keeps their number.
_BIN_SET_S, _LONG_SEGMENT_S, BIN_LONG_S, _BINS_PER_SEGMENT = 1.0, 120.0, 8.0, 1500
#: After a step of the rate samples stay by themselves so long, s: tables and filters ring for less.
_HEAD_S = 2.5
#: Readings of the supply are means over so long, s, so that their noise does not thin out what they explain.
_SUPPLY_S = 7.0
#: Samples further than this many robust standard deviations from their neighbours are bursts, not noise:
#: a Gaussian gives one in 5e8.
OUTLIER_SIGMAS = 6.0
#: Standard deviation of the noise in robust spreads of what the median of five leaves: that takes part of the noise with it.
_OF_MEDIAN = 1.25
#: Fewest isolated outliers that are bursts; fewer, which noise of heavy tails has as well, are left out with a note.
FEWEST_OUTLIERS = 5
#: A supply that changes less shows no dependence on it, V.
LEAST_SUPPLY_V = 0.02
#: Levels of samples of different averaging times are those of one white noise where they differ by less than this share.
_ONE_WHITE = 0.1
#: Samples whose interval is this near to the nominal one, as a share, are the sensor's own, not means.
_NATIVE = 0.2
#: An interval is a whole multiple of the usual one within this share; a clock is even where this share of them is.
_EVEN, _EVENLY = 0.2, 0.95
#: Share of the samples from which on it is said that they are missing.
_FEW_MISSING = 1e-3


@dataclass(frozen=True)
class Raw:
    """Facts about single samples that bins cannot carry; `sample_std_dps`: their white noise, as logged."""

    outliers_t_s: Floats
    outliers_dps: Floats
    samples: int
    sample_std_dps: float | None = None
    lattice_dps: float | None = None
    interval_ratio: float | None = None
    interval_ratio_std: float | None = None

    @property
    def rounding_dps(self) -> float:
        """How far the mean of many rounded samples may be off, deg/s; 0 where that is not known."""
        step, scatter = self.lattice_dps, self.sample_std_dps
        if step is None or scatter is None:
            return 0.0
        return mean_error(step, scatter)


@dataclass(frozen=True)
class Series:
    """Rows in time order; every array has shape (n,). None: the record does not carry that channel.

    Attributes
    ----------
    rate_dps, temp_c : ndarray
        Reference rate that the table reported; gyro temperature, smoothed over some seconds.
    white_std_dps : ndarray
        White noise of a row, in a unit of its own where `states_noise` is false; its level is estimated with the model.
    averaging_s, scatter_dps : ndarray
        Time that a row averages over; scatter of neighbouring samples of the segment that it is of.
    set_index : ndarray of int
        Segment (of a run) or data set (of a table) that the row belongs to.
    is_set : ndarray of bool
        Whether the row belongs to a data set of the paper (not to a ramp or soak).
    since_set_s, step_dps : ndarray
        Time since the segment began; the rate step that led to it.
    untestable : mapping
        Coordinate to the reason why this record cannot show it.
    reach : ndarray, shape (n, 4)
        Lowest and highest output and temperature as read in what the row is the mean of; temperatures may be NaN.
    """

    name: str
    t_s: Floats
    gyro_dps: Floats
    rate_dps: Floats
    temp_c: Floats
    white_std_dps: Floats
    averaging_s: Floats
    set_index: Ints
    is_set: Bools
    temp_rate_c_per_min: Floats
    history: TemperatureHistory
    raw: Raw
    chamber_c: Floats | None = None
    angle_deg: Floats | None = None
    supply_v: Floats | None = None
    since_power_on_s: Floats | None = None
    since_set_s: Floats | None = None
    step_dps: Floats | None = None
    untestable: Mapping[str, Reason] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    has_time: bool = True
    #: Rows were averages already (white noise has no stated averaging time).
    is_table: bool = False
    states_noise: bool = True
    #: Rows of a table that repeat an earlier one to the last digit.
    copies: int = 0
    #: Model and serial number, as far as they are stated.
    sensor: Mapping[str, str] = field(default_factory=lambda: {"model": "unknown"})
    reach: Floats | None = None
    scatter_dps: Floats | None = None

    def __len__(self) -> int:
        return int(self.t_s.size)

    def data_set_at(self, t_s: float) -> float:
        """Number of the data set, from 1, at a stand-in time; between two it is between theirs."""
        return float(np.interp(t_s, self.t_s, self.set_index)) + 1.0

    @property
    def time_coordinate(self) -> str:
        """The coordinate that stands for time: without times, the number of the data set."""
        return "time" if self.has_time else "data_set_index"

    @property
    def switched_on_s(self) -> float:
        """Instant that counts as switch-on where nobody says: when a run began, whatever of it was set aside."""
        t_s = self.history.t_s
        return switched_on_s(t_s) if self.is_table else float(t_s[0])

    def take(self, rows: Bools | Ints) -> Series:
        """The same, for some of the rows; the temperature history stays whole."""
        arrays: dict[str, Any] = {
            f.name: v[rows] for f in fields(self) if isinstance(v := getattr(self, f.name), np.ndarray)
        }
        return replace(self, **arrays)


def series_of_run(run: Run) -> Series:
    """Rows of a run directory: every segment, rate sets, ramps and soaks.

    Raises
    ------
    DataError
        Nothing usable in it.
    """
    parts: list[dict[str, Floats]] = []
    taken: list[_Samples] = []
    notes: list[Note] = list(run.notes)
    failed, rate_dps, unusable = 0, 0.0, 0
    for number, record in enumerate(run.segments):
        # The table turns where nothing of it is used, too.
        before_dps, rate_dps = rate_dps, record.rate_dps
        if record.outcome == "failed":
            failed += 1
            continue
        segment = run.segment(record)
        unusable += int((~segment.good).sum())
        if segment.good.sum() < 3:
            continue
        rows, samples = _segment_rows(segment, number, before_dps)
        rate_dps = float(rows["rate_dps"][0])
        parts.append(rows)
        taken.append(samples)
    if not parts:
        raise DataError(f"{run.path}: no segment has usable samples. Check the run with `gyrocal report`.")
    if failed:
        notes.append(Remark(Said.FAILED_SEGMENTS, {"count": failed}))
    aside = sum(s.set_aside for s in taken)
    if aside:
        notes.append(Remark(Said.SET_ASIDE_AFTER_STEPS, {"count": aside}))
    if unusable:
        notes.append(Remark(Said.UNUSABLE_SAMPLES, {"count": unusable}))
    if (missing := sum(s.missing for s in taken)) > _FEW_MISSING * sum(s.n for s in taken):
        notes.append(Remark(Said.MISSING_SAMPLES, {"count": missing}))
    notes += sample_notes(sum(s.outliers_t_s.size for s in taken), np.concatenate([s.temp_c for s in taken]))
    notes += [s.odd for s in taken if s.odd]
    columns = {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}
    return _assemble_run(run, columns, taken, notes)


def sample_notes(outliers: int, temp_c: Floats) -> list[Remark]:
    """What single samples and temperatures give cause to say."""
    notes = []
    if 0 < outliers < FEWEST_OUTLIERS:
        notes.append(Remark(Said.STRAY_SAMPLES, {"count": outliers}))
    known = temp_c[np.isfinite(temp_c)]
    if known.size and np.ptp(known) > 0 and np.array_equal(known, np.round(known)):
        notes.append(Remark(Said.WHOLE_DEGREES))
    return notes


@dataclass(frozen=True)
class _Samples:
    """What the rows of a segment do not carry of its samples.

    Attributes
    ----------
    odd : what is odd about the table's rate; empty: nothing
    gyro_dps, temp_c : of the good samples, and the former without outliers
    outliers_t_s, outliers_dps : isolated samples, and how far off they are
    set_aside : samples right after a step that stand out, and are none
    n, missing : good samples, and those that are nowhere among them
    """

    number: int
    is_set: bool
    odd: str
    averaging_s: float
    gyro_dps: Floats
    temp_c: Floats
    outliers_t_s: Floats
    outliers_dps: Floats
    set_aside: int
    span_s: float
    n: int
    missing: int
    noise_dps: float  # scatter of neighbouring samples


def _segment_rows(segment: Segment, number: int, before_dps: float) -> tuple[dict[str, Floats], _Samples]:
    good = segment.good
    t, gyro = segment.t_s[good], segment.gyro_dps[good]
    rate, _, odd = reference_rate(segment.record, reduce_segment([segment]))
    # Of samples that come in clumps most share a time stamp.
    step_s = float(np.median(np.diff(t)) or np.ptp(t) / (t.size - 1))
    averaging_s = segment.record.averaging_s or step_s
    outlier = outliers(gyro)
    # Right after a step, ringing that samples are too few to follow stands out like a burst and is none.
    settling = (t - segment.record.t_start_s < max(_HEAD_S, 10.0 * averaging_s)) & (rate != before_dps)
    bins = _bin_numbers(t, rate, step_s, float(segment.record.t_end_s - segment.record.t_start_s))
    keep = ~outlier
    count = np.bincount(bins[keep], minlength=bins[-1] + 1).astype(np.float64)
    filled = count > 0

    def mean(values: Floats) -> Floats:
        total = np.bincount(bins[keep], weights=values[keep], minlength=bins[-1] + 1)
        return np.asarray(total[filled] / count[filled])

    size = int(filled.sum())
    scatter_dps = float(np.std(np.diff(gyro[keep])) / np.sqrt(2.0))
    rows = {
        "t_s": mean(t),
        "gyro_dps": mean(gyro),
        "temp_raw_c": mean(segment.gyro_temp_c[good]),
        "rate_dps": np.full(size, rate),
        "count": count[filled],
        "sample_s": np.full(size, averaging_s),
        "scatter": np.full(size, scatter_dps),
        "set_index": np.full(size, float(number)),
        "is_set": np.full(size, float(segment.record.kind == "rate")),
        # The step is over when a data set begins, though a sample's time may be rounded to before that.
        "since_set_s": np.maximum(mean(t) - segment.record.t_start_s, 0.0),
        "step_dps": np.full(size, rate - before_dps),
        "angle_deg": mean(_at(segment.bench_t_s, segment.table_angle_deg, t, rate)),
        "supply_v": mean(_at(segment.bench_t_s, _smooth(segment.supply_v, segment.bench_t_s), t, 0.0)),
        "chamber_c": mean(_at(segment.bench_t_s, segment.chamber_temp_c, t, 0.0)),
        "reach": reach_of(bins[keep], gyro[keep], segment.gyro_temp_c[good][keep]),
    }
    return rows, _Samples(
        number=number,
        is_set=segment.record.kind == "rate",
        odd=odd,
        averaging_s=averaging_s,
        gyro_dps=gyro[keep],
        temp_c=segment.gyro_temp_c[good],
        outliers_t_s=t[outlier & ~settling],
        outliers_dps=gyro[outlier & ~settling] - np.median(gyro),
        set_aside=int((outlier & settling).sum()),
        span_s=float(t[-1] - t[0]),
        # Unusable samples leave gaps, too.
        missing=max(missing_samples(t) - int(np.sum(np.diff(np.flatnonzero(good)) - 1)), 0),
        n=t.size,
        noise_dps=scatter_dps,
    )


def reach_of(bins: Ints, gyro_dps: Floats, temp_c: Floats) -> Floats:
    """Lowest and highest output and temperature of each bin that has samples, shape (bins, 4)."""
    ends = []
    for values in (gyro_dps, temp_c):
        for extreme in (np.fmin, np.fmax):
            end = np.full(int(bins.max()) + 1, np.nan)
            extreme.at(end, bins, values)
            ends.append(end)
    return np.stack(ends, axis=1)[np.unique(bins)]


def missing_samples(t_s: Floats) -> int:
    """Samples that are not there: of an even clock the intervals are whole multiples of the usual one, their median."""
    interval_s = np.diff(t_s)
    usual_s = float(np.median(interval_s))
    if usual_s <= 0.0:
        return 0
    steps = interval_s / usual_s
    even = np.abs(steps - np.round(steps)) < _EVEN
    # Clumps and jitter have no multiples.
    return int(np.sum(np.round(steps) - 1.0)) if np.mean(even & (steps > 0.5)) > _EVENLY else 0


def outliers(gyro: Floats) -> Bools:
    """Samples that stand out from the median of their five neighbours, shape (n,)."""
    if gyro.size < 7:
        return np.zeros(gyro.size, dtype=bool)
    padded = np.pad(gyro, 2, mode="reflect")
    local = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    deviation = gyro - local
    # At either end there are neighbours on one side only: a straight line through them, whose noise is sqrt(6)
    # times a sample's where the median's is a little more than one, so that a decay after a step is no outlier.
    ends = np.array([0, -1])
    inner, second = gyro[[1, -2]], gyro[[2, -3]]
    deviation[ends] = (gyro[ends] - 2.0 * inner + second) * _OF_MEDIAN / np.sqrt(6.0)
    away = np.abs(deviation)
    if not away.any():
        return np.zeros(gyro.size, dtype=bool)
    spread = STDS_PER_MAD * float(np.median(away[away > 0.0]))
    return np.asarray(away > OUTLIER_SIGMAS * _OF_MEDIAN * spread)


def _bin_numbers(t: Floats, rate: float, step_s: float, duration_s: float) -> Ints:
    longest = _BIN_SET_S
    if duration_s > _LONG_SEGMENT_S:
        longest = max(BIN_LONG_S, duration_s / _BINS_PER_SEGMENT)
    length = min(longest, _BIN_TURN_DEG / max(abs(rate), 1e-9))
    per_bin = max(1, int(length / step_s + 1e-6))
    if per_bin == 1:
        return np.arange(t.size)
    head = int(np.searchsorted(t, t[0] + _HEAD_S)) if duration_s <= _LONG_SEGMENT_S else 0
    body = np.arange(t.size - head) // per_bin + head
    return np.concatenate([np.arange(head), body]).astype(np.int64)


def _at(bench_t_s: Floats, values: Floats, t_s: Floats, slope: float) -> Floats:
    """A bench reading at the gyro's own times; beyond the readings it goes on at `slope` a second."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(t_s.size, np.nan)
    times, v = bench_t_s[known], values[known]
    inside = np.interp(t_s, times, v)
    inside = inside + slope * np.minimum(t_s - times[0], 0.0)
    return np.asarray(inside + slope * np.maximum(t_s - times[-1], 0.0))


def _smooth(values: Floats, bench_t_s: Floats) -> Floats:
    """Running mean over some seconds of readings."""
    known = np.isfinite(values)
    if known.sum() < 3:
        return values
    width = max(1, int(_SUPPLY_S / max(float(np.median(np.diff(bench_t_s[known]))), 1e-3)) // 2 * 2 + 1)
    kernel = np.ones(min(width, int(known.sum()) // 2 * 2 - 1))
    smooth = np.array(values)
    v = values[known]
    smooth[known] = np.convolve(v, kernel, "same") / np.convolve(np.ones(v.size), kernel, "same")
    return smooth


def _assemble_run(run: Run, c: dict[str, Floats], taken: list[_Samples], notes: list[Note]) -> Series:
    untestable: dict[str, Reason] = {}

    def channel(key: str, coordinate: str, why: Why) -> Floats | None:
        values = c[key]
        if np.isfinite(values).all():
            return values
        untestable[coordinate] = Lack(why)
        return None

    logged = c["temp_raw_c"]
    if np.isnan(logged).all():
        if np.isnan(c["chamber_c"]).all():
            raise DataError(f"{run.path}: no temperature was logged, so no surface can be evaluated.")
        logged = c["chamber_c"]
        notes.append(Remark(Said.CHAMBER_FOR_GYRO))
    sampled_c = np.concatenate([s.temp_c for s in taken])
    step_c = lattice(sampled_c[np.isfinite(sampled_c)])
    history = temperature_history(c["t_s"], logged, c["count"], step_c, all_along=True)
    angle = channel("angle_deg", "table_angle", Why.ANGLE_NOT_LOGGED)
    supply = channel("supply_v", "supply", Why.SUPPLY_NOT_LOGGED)
    since_on = None
    if run.power_on_t_s is None:
        untestable["time_since_power_on"] = Lack(Why.NO_POWER_ON)
    else:
        since_on = _since_power_on(run, c["t_s"])
    if supply is not None and np.ptp(supply) < LEAST_SUPPLY_V:
        untestable["supply"] = Lack(Why.STEADY_SUPPLY)
    raw = _raw_facts(run, taken)
    return Series(
        name=run.path.name,
        sensor={"model": run.sensor.model} | ({"serial": run.sensor.serial} if run.sensor.serial else {}),
        t_s=c["t_s"],
        gyro_dps=c["gyro_dps"],
        rate_dps=c["rate_dps"],
        temp_c=history.temp_at(c["t_s"]),
        white_std_dps=_white_std(c, taken, (raw.lattice_dps or 0.0) / np.sqrt(12.0)),
        averaging_s=c["count"] * c["sample_s"],
        scatter_dps=c["scatter"],
        set_index=c["set_index"].astype(np.int64),
        is_set=c["is_set"] > 0,
        temp_rate_c_per_min=history.rate_at(c["t_s"]),
        history=history,
        raw=raw,
        chamber_c=c["chamber_c"] if np.isfinite(c["chamber_c"]).all() else None,
        angle_deg=angle,
        supply_v=supply,
        since_power_on_s=since_on,
        since_set_s=c["since_set_s"],
        step_dps=c["step_dps"],
        reach=c["reach"],
        untestable=untestable,
        notes=tuple(notes),
    )


def _since_power_on(run: Run, t_s: Floats) -> Floats:
    """Time since the last power-on; a run may cycle the power on purpose (journal event ``power_on``)."""
    starts = [float(run.power_on_t_s or 0.0)]
    starts += [float(e["t_s"]) for e in run.events if e.get("event") == "power_on" and "t_s" in e]
    on = np.sort(np.array(starts))
    return np.asarray(t_s - on[np.maximum(np.searchsorted(on, t_s, side="right") - 1, 0)])


def _white_std(c: dict[str, Floats], taken: list[_Samples], rounding_dps: float) -> Floats:
    """Relative white noise of each row: from the averaging times where they agree with the samples' scatter.

    A data set that stands at one step of the output is off by its rounding, however long it is.
    """
    times = np.array([s.averaging_s for s in taken])
    scatter = np.array([s.noise_dps for s in taken])
    counts = np.array([s.n for s in taken], dtype=np.float64)
    least = max(rounding_dps, 1e-9)
    level = {}
    for averaging in np.unique(times):
        chosen = times == averaging
        middle = np.median(np.repeat(scatter[chosen], np.maximum(counts[chosen] // 10, 1).astype(int)))
        level[averaging] = float(middle) or least
    walk = np.array([level[a] * np.sqrt(a) for a in level])
    reference = float(np.median(walk))
    std = np.empty(c["count"].size)
    for averaging, sigma in level.items():
        rows = c["sample_s"] == averaging
        stated = reference / np.sqrt(averaging)
        # Logged samples may be points rather than means (aliasing): then the scatter itself is right.
        std[rows] = (stated if abs(sigma / stated - 1.0) < _ONE_WHITE else sigma) / np.sqrt(c["count"][rows])
    still = [s.number for s in taken if s.noise_dps == 0.0]
    return np.asarray(np.maximum(std, np.where(np.isin(c["set_index"], still), least, 1e-9)))


def _raw_facts(run: Run, taken: list[_Samples]) -> Raw:
    sets = [s for s in taken if s.is_set] or taken
    ratio = ratio_std = None
    if run.sensor.sample_rate_hz:
        spans = np.array([s.span_s / max(s.n - 1 + s.missing, 1) for s in sets])
        nominal = np.array([s.averaging_s for s in sets])
        native = np.isclose(nominal, 1.0 / run.sensor.sample_rate_hz, rtol=_NATIVE)
        if native.sum() >= 3:
            each = spans[native] * run.sensor.sample_rate_hz - 1.0
            ratio = float(np.median(each))
            # Of a median: sqrt(pi / 2) times that of a mean.
            ratio_std = float(
                STDS_PER_MAD * np.median(np.abs(each - ratio)) * np.sqrt(0.5 * np.pi / native.sum())
            )
    return Raw(
        outliers_t_s=np.concatenate([s.outliers_t_s for s in taken]),
        outliers_dps=np.concatenate([s.outliers_dps for s in taken]),
        samples=int(sum(s.n for s in taken)),
        sample_std_dps=float(np.median([s.noise_dps for s in sets])),
        lattice_dps=lattice(np.concatenate([s.gyro_dps for s in sets])),
        interval_ratio=ratio,
        interval_ratio_std=ratio_std,
    )


def set_means(series: Series, values: Floats) -> tuple[Ints, Floats]:
    """Numbers of the data sets, and the weighted means of values over them."""
    rows = series.is_set
    weight = 1.0 / series.white_std_dps[rows] ** 2
    index = series.set_index[rows]
    total = np.bincount(index, weights=weight)
    numbers = np.flatnonzero(total)
    return numbers, np.bincount(index, weights=weight * values[rows])[numbers] / total[numbers]
