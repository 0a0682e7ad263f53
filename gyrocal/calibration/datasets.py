"""Data sets: what a recording says about each rate and temperature, reduced as it is read.

A run directory is read a block at a time; a block is reduced to counts, means and centred sums of squares, and the
sums of two blocks are merged (Chan, Golub, LeVeque 1983). That is exact in one pass, stable for means far from
zero, and its memory does not grow with the number of samples.

Reference rate of a data set, the best that the recording has:

1. the slope of the table angle over the segment, where it is known better than the mean of the reported rates, or
   where the two disagree by more than five of its standard errors (a report that echoes the command). It integrates
   servo cogging and wow, where the mean of sampled rates aliases them. An angle whose
   time stamps are coarse is known worse than a steady report, and one that is wrapped is no rate at all;
2. the mean of the rates that the table reported;
3. the commanded rate in the journal.

Which one was taken stands in `DataSets.reference`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.moments import EMPTY, SegmentSums, sums_of_block
from gyrocal.calibration.provenance import source_sha256
from gyrocal.calibration.rest import RestWindows
from gyrocal.errors import DataError, InputError
from gyrocal.inference.flicker import Rest, merge_rest
from gyrocal.records.datasets import DataSetTable, read_data_sets
from gyrocal.records.run import Run, Segment, SegmentRecord, read_run

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Texts = NDArray[np.str_]

#: Kinds of segment that hold one rate at one temperature; ramps and soaks are for diagnosis.
CONSTANT_KINDS = ("rate", "static")

#: The angle must cover this share of a segment's time to stand for its rate.
_ANGLE_COVERAGE = 0.5
#: Whatever its scatter, no slope is known better: readings have a last digit.
_LEAST_ERROR_DPS = 1e-9
#: A report that is further off the slope of the angle, in its standard errors, is not what the table did.
_ECHO_SIGMAS = 5.0
#: Angle and reported rate that differ by more (relative, deg/s) are not the same motion: a wrapped angle, mostly.
_ANGLE_RELATIVE = 0.01
_ANGLE_ABSOLUTE_DPS = 0.1
#: Samples beyond this many standard deviations do not widen what a data set covers.
_REACH = 5.0
#: A data set is saturated when this share of its samples stands at the recording's extreme value.
_RAIL_SHARE = 0.2


@dataclass(frozen=True)
class DataSets:
    """Data sets as arrays, shape (n,), in time order; NaN is unknown.

    Attributes
    ----------
    rate_dps, gyro_dps, temp_c : ndarray
        Reference rate, mean output, mean gyro temperature.
    gyro_std_dps, n : ndarray
        Standard deviation of the samples of a data set, and their number.
    gyro_peak_dps : ndarray
        Largest distance of a sample from the mean of its data set.
    t_s, duration_s : ndarray
        Mid time since the run began, and the time from the first sample to the last plus one averaging time.
    temp_rate_c_per_min : ndarray
    averaging_s : ndarray
        Averaging time of a sample.
    segment : ndarray of int
        Id of the segment, or number of the table's row, counted from 1.
    outcome, kind, reference : ndarray of str
        ``ok`` or ``unsettled``; ``rate``, ``static``; ``angle``, ``table``, ``command`` or ``given``.
    """

    rate_dps: Floats
    gyro_dps: Floats
    temp_c: Floats
    gyro_std_dps: Floats
    n: Floats
    gyro_peak_dps: Floats
    t_s: Floats
    duration_s: Floats
    temp_rate_c_per_min: Floats
    averaging_s: Floats
    segment: Ints
    outcome: Texts
    kind: Texts
    reference: Texts

    def __len__(self) -> int:
        return int(self.rate_dps.size)

    @property
    def error_dps(self) -> Floats:
        """Error of each data set, ``gyro - rate`` (paper eq. 1)."""
        return self.gyro_dps - self.rate_dps

    @property
    def mean_variance_dps2(self) -> Floats:
        """Variance of each mean if samples were independent, ``std^2 / n``; NaN is unknown."""
        return self.gyro_std_dps**2 / self.n

    @property
    def timed(self) -> bool:
        """Whether the time of every data set is known."""
        return bool(np.isfinite(self.t_s).all())

    def select(self, rows: NDArray[Any]) -> DataSets:
        """The data sets of a mask or of indices."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def describe(self, row: int) -> str:
        """A data set in a sentence: its segment, rate and temperature."""
        return f"data set {self.segment[row]} ({self.rate_dps[row]:+.4g} deg/s, {self.temp_c[row]:.1f} °C)"


@dataclass(frozen=True)
class Excluded:
    """A segment that gives no data set, and why."""

    segment: int
    rate_dps: float
    temp_c: float
    reason: str


@dataclass(frozen=True)
class Masked:
    """Samples that the means leave out (bad status, not finite), or that stand at the gyro's rail."""

    bad_status: int = 0
    non_finite: int = 0
    saturated: int = 0


@dataclass(frozen=True)
class Recording:
    """A recording, reduced to data sets.

    Attributes
    ----------
    sha256 : str
        Of the table's bytes; for a run directory of ``run.json`` and the journal, which holds the sha256 of each segment.
    sensor : dict
        The ``sensor`` entry of the coefficient file.
    sets : DataSets
    saturated : ndarray of bool, shape (n,)
        Data sets with a good part of their samples at the rail.
    whole_degrees : bool
        Every temperature is a whole degree: a coarse sensor, or nominal temperatures.
    run : Run or None
        For those who need the samples.
    reach : ndarray, shape (n, 4), or None
        Lowest and highest output (deg/s) and temperature (°C) of the samples of each data set, stray ones apart;
        None for a table.
    rest : Rest or None
        What segments at rest (soaks too, once steady) say about drift.
    """

    source: Path
    sha256: str
    sensor: dict[str, Any]
    sets: DataSets
    saturated: NDArray[np.bool_]
    whole_degrees: bool
    n_samples: int
    masked: Masked
    excluded: tuple[Excluded, ...]
    notes: tuple[str, ...]
    run: Run | None = None
    counts_per_dps: float | None = None
    reach: Floats | None = None
    rest: Rest | None = None


def load_recording(path: Path, counts_per_dps: float | None = None) -> Recording:
    """Read a run directory or a table of data sets.

    Parameters
    ----------
    counts_per_dps : float, optional
        Nominal scale of a table in ``gyro_counts``, sign included.

    Raises
    ------
    InputError
        A file is missing, malformed, truncated or edited; or `counts_per_dps` where nothing is in counts.
    DataError
        The run holds no usable data set.
    """
    if not path.is_dir():
        return _from_table(read_data_sets(path, counts_per_dps))
    if counts_per_dps is not None:
        raise InputError(f"{path}: a run is in deg/s already; --counts-per-dps is for tables. Leave it out.")
    return recording_of(read_run(path))


def _from_table(table: DataSetTable) -> Recording:
    size, std = table.rate_dps.size, table.gyro_std_dps
    unknown = np.full(size, np.nan)
    if (
        std is not None
        and not std.any()
        and np.ptp(table.rate_dps) > 0
        and (table.n is None or np.any(table.n > 1))
    ):
        # Each of its data sets would pass for one of a gyro that is stuck.
        raise InputError(
            f"{table.source}: gyro_std_dps is 0 in every row, by which no data set has a weight. Leave the column out."
        )

    def known(values: Floats | None) -> Floats:
        return unknown if values is None else values

    sets = DataSets(
        rate_dps=table.rate_dps,
        gyro_dps=table.gyro_dps,
        temp_c=table.temp_c,
        gyro_std_dps=known(table.gyro_std_dps),
        n=known(table.n),
        gyro_peak_dps=unknown,
        t_s=known(table.t_s),
        duration_s=unknown,
        temp_rate_c_per_min=known(table.temp_rate_c_per_min),
        averaging_s=unknown,
        segment=np.arange(1, size + 1),
        outcome=np.full(size, "ok"),
        kind=np.full(size, "rate"),
        reference=np.full(size, "given"),
    )
    optional = {"gyro_std_dps": table.gyro_std_dps, "n": table.n, "t_s": table.t_s}
    unsaid = ", ".join(name for name, values in optional.items() if values is None)
    notes = (f"the table does not say {unsaid}",) if unsaid else ()
    return Recording(
        source=table.source,
        sha256=source_sha256(table.source),
        sensor={"model": "unknown"},
        sets=sets,
        saturated=_saturated_means(table.rate_dps, table.gyro_dps),
        whole_degrees=_whole(table.temp_c),
        n_samples=int(table.n.sum()) if table.n is not None else 0,
        masked=Masked(),
        excluded=(),
        notes=(*notes, *table.notes),
        counts_per_dps=table.counts_per_dps,
    )


def _whole(values: Floats) -> bool:
    return bool(np.all(values == np.round(values)))


def _saturated_means(rate_dps: Floats, gyro_dps: Floats) -> NDArray[np.bool_]:
    """Means that share the recording's extreme value to the last digit while their rates differ."""
    saturated = np.zeros(rate_dps.shape, dtype=np.bool_)
    for extreme in (gyro_dps.max(), gyro_dps.min()):
        rows = gyro_dps == extreme
        if np.unique(rate_dps[rows]).size > 1 and extreme != 0.0:
            saturated |= rows
    return saturated


def recording_of(run: Run) -> Recording:
    """Data sets of a run that was opened.

    Raises
    ------
    InputError, DataError
        As `load_recording`.
    """
    rows: list[tuple[SegmentRecord, SegmentSums, float, str]] = []
    notes = list(run.notes)
    bad_status = non_finite = n_samples = 0
    reduced, excluded, rest = _reduce(run)
    if any(s.chamber.n for _, s in reduced) and not any(s.temp.n for _, s in reduced):
        # A thermometer that is dead in some segments only is another matter: those are left out below.
        reduced = [(record, sums.by_chamber()) for record, sums in reduced]
        notes.append(
            "the gyro sends no temperature: the chamber's stands for its own, and how far the gyro lags behind is unknown"
        )
    for record, sums in reduced:
        bad_status += sums.bad_status
        non_finite += sums.non_finite
        n_samples += sums.gyro.n + sums.bad_status + sums.non_finite
        missing = (
            "no good gyro sample" if sums.gyro.n < 2 else "no gyro temperature" if sums.temp.n == 0 else ""
        )
        if missing:
            excluded.append(Excluded(record.id, record.rate_dps, record.chamber_c, f"it holds {missing}"))
            continue
        rate_dps, reference, note = reference_rate(record, sums)
        notes += [note] if note else []
        rows.append((record, sums, rate_dps, reference))
    if not rows:
        reasons = f" ({len(excluded)} were left out: {excluded[0].reason})" if excluded else ""
        msg = f"{run.path}: holds no usable data set{reasons}. Record segments of kind rate, one a rate and temperature; "
        msg += f"what a gyro at rest says of noise and bias is gyrocal noise {run.path}."
        raise DataError(msg)
    notes += _references_said(rows)
    saturated, at_rail = _saturated_sums([sums for _, sums, _, _ in rows])
    return Recording(
        source=run.path,
        sha256=source_sha256(run.path),
        sensor=run.sensor.to_json(),
        sets=_sets_of(rows),
        saturated=saturated,
        whole_degrees=all(sums.temp.whole for _, sums, _, _ in rows),
        n_samples=n_samples,
        masked=Masked(bad_status, non_finite, at_rail),
        excluded=tuple(excluded),
        notes=tuple(notes),
        run=run,
        reach=np.array([(*s.gyro.within(_REACH), *s.temp.within(_REACH)) for _, s, _, _ in rows]),
        rest=merge_rest(rest),
    )


def _reduce(
    run: Run,
) -> tuple[list[tuple[SegmentRecord, SegmentSums]], list[Excluded], list[Rest | None]]:
    """Sums of each segment at one rate and one temperature, those that the bench gave up, and what rest says."""
    reduced: list[tuple[SegmentRecord, SegmentSums]] = []
    excluded: list[Excluded] = []
    rest: list[Rest | None] = []
    for record in run.segments:
        windows = RestWindows(record)
        if record.kind not in CONSTANT_KINDS:
            if windows.wanted:
                run.verify(record)
                rest.append(windows.of(run.iterate_segment(record)))
            continue
        if record.outcome == "failed":
            reason = "the bench marked it failed"
            excluded.append(Excluded(record.id, record.rate_dps, record.chamber_c, reason))
            continue
        run.verify(record)
        reduced.append((record, reduce_segment(windows.watch(run.iterate_segment(record)))))
        rest.append(windows.rest())
    return reduced, excluded, rest


def reduce_segment(blocks: Iterable[Segment]) -> SegmentSums:
    """Sums of a segment from its blocks, in time order; memory is that of one block."""
    sums = EMPTY
    for block in blocks:
        sums = sums.merge(sums_of_block(block))
    return sums


def reference_rate(record: SegmentRecord, sums: SegmentSums) -> tuple[float, str, str]:
    """Reference rate (deg/s) of a segment, where it comes from, and a note when something is odd."""
    table, slope = sums.table_rate, sums.angle_slope_dps()
    if slope is None or sums.angle_span_s < _ANGLE_COVERAGE * sums.span_s:
        return (table.mean, "table", "") if table.n else (record.rate_dps, "command", "")
    angle, error = record.rate_dps + slope[0], max(slope[1], _LEAST_ERROR_DPS)
    if table.n == 0:
        return angle, "angle", ""
    apart = abs(angle - table.mean)
    if apart > _ANGLE_ABSOLUTE_DPS + _ANGLE_RELATIVE * abs(table.mean):
        note = (
            f"segment {record.id}: the table angle moves at {angle:.4g} deg/s and the table reports {table.mean:.4g}; "
            "the report is taken (is the angle wrapped?)"
        )
        return table.mean, "table", note
    report_error = table.std() / math.sqrt(table.n) if table.n > 1 else math.inf
    if error < report_error or apart > _ECHO_SIGMAS * error:
        return angle, "angle", ""
    return table.mean, "table", ""


def _references_said(rows: Sequence[tuple[SegmentRecord, SegmentSums, float, str]]) -> list[str]:
    """What is to be said of the rates that the table reports, or does not."""
    turned = [
        (record.rate_dps, rate, reference) for record, _, rate, reference in rows if record.rate_dps != 0.0
    ]
    unread = sum(reference == "command" for *_, reference in turned)
    said = []
    if unread:
        said.append(
            f"the table reports no rate or angle in {unread} of {len(turned)} segments that turn: the commanded rate is taken for true"
        )
    measured = [command * rate for command, rate, reference in turned if reference != "command"]
    if measured and max(measured) < 0.0:
        said.append(
            "the rate that the table reports has the other sign than the one commanded, in every segment: the report is taken; "
            "check which way is positive (counter-clockwise from above)"
        )
    return said


def _saturated_sums(rows: Sequence[SegmentSums]) -> tuple[NDArray[np.bool_], int]:
    """Data sets at the rail, and how many samples stand there."""
    ends = np.array([(s.gyro.low, s.gyro.high) for s in rows])
    return at_the_rail(
        ends, np.array([(s.gyro.n_low, s.gyro.n_high) for s in rows]), np.array([s.gyro.n for s in rows])
    )


def at_the_rail(ends: Floats, counts: Ints, n: Ints) -> tuple[NDArray[np.bool_], int]:
    """Which stretches of a recording are saturated, and how many samples stand at the rail.

    Parameters
    ----------
    ends, counts : ndarray, shape (k, 2)
        Least and largest output of each stretch, and how many samples have it.
    n : ndarray, shape (k,)
        Samples of each stretch.

    The rail is the recording's extreme value. A coarse output step also repeats its extremes; then every data set
    does so, also those far from the rail, and nothing is called saturated.
    """
    share = counts / n[:, None]
    at_rail = ends == np.array([ends[:, 0].min(), ends[:, 1].max()])
    usual = np.median(share[~at_rail]) if (~at_rail).any() else 0.0
    alive = (ends[:, 0] != ends[:, 1]) | (ends[:, 0] != 0.0)
    hit = at_rail & (share >= max(_RAIL_SHARE, 4 * usual)) & alive[:, None]
    return np.asarray(hit.any(axis=1)), int(counts[hit].sum())


def _sets_of(rows: Sequence[tuple[SegmentRecord, SegmentSums, float, str]]) -> DataSets:
    records, sums, rates, references = zip(*rows, strict=True)
    averaging = np.array([np.nan if r.averaging_s is None else r.averaging_s for r in records])
    spacing = np.array([s.span_s / (s.gyro.n - 1) for s in sums])
    return DataSets(
        rate_dps=np.array(rates),
        gyro_dps=np.array([s.gyro.mean for s in sums]),
        temp_c=np.array([s.temp.mean for s in sums]),
        gyro_std_dps=np.array([s.gyro.std() for s in sums]),
        n=np.array([float(s.gyro.n) for s in sums]),
        gyro_peak_dps=np.array([s.gyro.peak for s in sums]),
        t_s=np.array([0.5 * (s.t_first_s + s.t_last_s) for s in sums]),
        duration_s=np.array([s.span_s for s in sums]) + np.where(np.isnan(averaging), spacing, averaging),
        temp_rate_c_per_min=np.array([s.temp_rate_c_per_min() for s in sums]),
        averaging_s=averaging,
        segment=np.array([r.id for r in records]),
        outcome=np.array([r.outcome for r in records]),
        kind=np.array([r.kind for r in records]),
        reference=np.array(references),
    )
