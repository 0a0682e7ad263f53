"""Many units of one type: each fitted by itself, then what they have in common, who is out of line, what drifts."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.calibrate import Calibration, FitConfig, calibrate, configs
from gyrocal.calibration.provenance import UNKNOWN, refuse_twice, sensor_of
from gyrocal.errors import DataError, DeviceError, GyrocalError, InputError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.inference.multiple import holm
from gyrocal.units import DPS_TO_DPH, NORMAL_95
from gyrocal.workers import deaf_to_interrupts

Floats = NDArray[np.float64]

#: Rate at which a fleet without a bad unit, or without a drift, is said to have one, over all figures together.
ALARM_RATE = 0.01
#: Share of the units that may be out of line at the most (Rosner's test looks for so many at once).
_MOST_OUTLYING = 0.2
#: So many recordings of a model are listed where there are several models.
_FEW = 3
#: Units below which neither is looked for.
LEAST_UNITS = 5


@dataclass(frozen=True)
class Unit:
    """One recording, fitted.

    Attributes
    ----------
    figures : mapping
        Figure (with its unit as suffix) to value and standard deviation.
    error : str
        Why it could not be fitted; empty where it could.
    seconds : float
        Time that reading and fitting took.
    """

    source: str
    serial: str
    model: str
    created_utc: str
    figures: Mapping[str, tuple[float, float]]
    error: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Spread:
    """One figure over the units: median, range, standard deviation between units and the mean one within a unit."""

    figure: str
    n: int
    median: float
    low: float
    high: float
    between: float
    within: float


@dataclass(frozen=True)
class Outlying:
    """A unit out of line: by how many standard deviations of the others, p-value over all figures together."""

    serial: str
    source: str
    figure: str
    value: float
    deviations: float
    p_value: float


@dataclass(frozen=True)
class Drift:
    """A figure that changes along the serial numbers: change per unit (Theil and Sen) with its 95 % interval."""

    figure: str
    per_unit: float
    low: float
    high: float
    p_value: float


@dataclass(frozen=True)
class Fleet:
    """All units in the order of their serials, and what they tell together."""

    units: tuple[Unit, ...]
    spreads: tuple[Spread, ...]
    outlying: tuple[Outlying, ...]
    drifts: tuple[Drift, ...]

    @property
    def failed(self) -> tuple[Unit, ...]:
        """Units that could not be fitted."""
        return tuple(unit for unit in self.units if unit.error)


def measure(path: Path, config: FitConfig) -> Unit:
    """Fit one recording; what is wrong with it is said in the unit and does not stop the others."""
    begun = time.perf_counter()
    try:
        found = calibrate(path, config)
    except GyrocalError as error:
        said = str(error).removeprefix(f"{path}: ")
        return Unit(str(path), "", "", "", {}, said, time.perf_counter() - begun)
    file = found.coefficients
    return Unit(
        source=str(path),
        serial=str(file.sensor.get("serial") or path.name),
        model=_known(file.sensor.get("model")),
        created_utc=str(file.provenance.get("created_utc") or ""),
        figures=_figures(found, file),
        seconds=time.perf_counter() - begun,
    )


def _known(model: object) -> str:
    """A table of data sets says nothing of its sensor."""
    return "" if model in (None, "unknown") else str(model)


def _figures(found: Calibration, file: Coefficients) -> dict[str, tuple[float, float]]:
    figures = {}
    listed = [pair.before for pair in found.merit.values()] + list(found.noise.figures.values())
    for figure in listed:
        if figure.interval is not None:
            value, low, high = figure.interval
            figures[f"{figure.name} [{figure.unit}]"] = (value, (high - low) / (2.0 * NORMAL_95))
    figures["residual_rms [deg/h]"] = (found.after_dps * DPS_TO_DPH, math.nan)
    std = np.sqrt(np.diag(file.covariance_dps2))
    for k, value in enumerate(file.surface.coefficients_dps.ravel()):
        figures[f"c{k // 3}{k % 3} [deg/s]"] = (float(value), float(std[k]))
    return figures


@dataclass(frozen=True)
class FleetConfig:
    """Which recordings, and who does the work: processes of this machine, or a Dask cluster."""

    recordings: tuple[Path, ...]
    jobs: int | None = None
    dask: str | None = None
    counts_per_dps: float | None = None


def measure_fleet(config: FleetConfig, tell: Callable[[float, str], None]) -> Fleet:
    """Fit every recording on the workers that `config` names, and put the units beside each other.

    Raises
    ------
    DataError
        Nothing to compare, units of different models, or a recording that is given twice. InputError, DeviceError: no library for Dask, or no cluster answers.
    """
    if len(config.recordings) < 2:
        raise DataError("One recording is given, and a fleet has two at least: give more, or use `fit`.")
    refuse_twice(config.recordings)
    refuse_models(config.recordings)
    # One set of terms for all: where each unit has those that predict it best, equal units have unlike coefficients.
    each = [replace(one, paper=True) for one in configs(config.recordings, config.counts_per_dps)]
    with _workers(config) as executor:
        return compare_units(list(measure_all(config.recordings, each, executor, tell)))


@contextmanager
def _workers(config: FleetConfig) -> Iterator[Executor]:
    if config.dask is None:
        pool = ProcessPoolExecutor(config.jobs or os.cpu_count())
        try:
            yield pool
        finally:
            # Of an interrupted fleet nobody waits for the rest.
            pool.shutdown(cancel_futures=True)
        return
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise InputError("--dask needs the extra: pip install 'gyrocal[dask]'.") from error
    try:
        client = Client(config.dask, timeout="10s")
    except (OSError, TimeoutError) as error:
        raise DeviceError(
            f"No Dask scheduler answers at {config.dask} ({error}): start one, or leave out --dask."
        ) from error
    # A task whose worker dies goes to another one: the scheduler sees to that.
    with client, client.get_executor(retries=3) as executor:
        yield executor


def measure_all(
    paths: Sequence[Path],
    each: Sequence[FitConfig],
    executor: Executor,
    tell: Callable[[float, str], None],
) -> Iterator[Unit]:
    """Fit every recording as its entry of `each` says, on the workers of `executor`; units come as they are done."""
    with deaf_to_interrupts():
        waiting = {
            executor.submit(measure, path, config): path for path, config in zip(paths, each, strict=True)
        }
    for done, future in enumerate(as_completed(waiting), start=1):
        tell(done / len(paths), waiting[future].name)
        yield future.result()


def refuse_models(paths: Sequence[Path]) -> None:
    """Refuse units of different models, before any of them is fitted.

    Raises
    ------
    DataError
        With the models.
    """
    models: dict[str, list[str]] = {}
    for path in paths:
        models.setdefault(sensor_of(path).model, []).append(str(path))
    models.pop(UNKNOWN, None)
    if len(models) > 1:
        each = sorted(
            f"{model} ({', '.join(sources[:_FEW])}{', …' if len(sources) > _FEW else ''})"
            for model, sources in models.items()
        )
        raise DataError(f"The recordings are of {', '.join(each)}: compare units of one model.")


def compare_units(units: Sequence[Unit]) -> Fleet:
    """Put units beside each other.

    Raises
    ------
    DataError
        None of them could be fitted.
    """
    good = [unit for unit in units if not unit.error]
    if not good:
        raise DataError(
            f"None of the {len(units)} recordings can be fitted; the first says: {units[0].error}"
        )
    ordered = sorted(units, key=lambda unit: (_natural(unit.serial), unit.created_utc, unit.source))
    table = _table([unit for unit in ordered if not unit.error])
    return Fleet(
        tuple(ordered),
        tuple(_spread(name, *columns) for name, columns in table.items()),
        _outlying([unit for unit in ordered if not unit.error], table),
        _drifts(table),
    )


def _natural(serial: str) -> tuple[tuple[int, int, str], ...]:
    """Serials in the order in which people count: A9 before A10."""
    parts: list[str] = []
    for letter in serial:
        if parts and parts[-1].isdigit() == letter.isdigit():
            parts[-1] += letter
        else:
            parts.append(letter)
    return tuple((0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts)


def _table(units: Sequence[Unit]) -> dict[str, tuple[Floats, Floats]]:
    """Figure to values and standard deviations, shape (units,); NaN where a unit does not have it."""
    names = list(dict.fromkeys(name for unit in units for name in unit.figures))
    nothing = (math.nan, math.nan)
    return {
        name: (
            np.array([unit.figures.get(name, nothing)[0] for unit in units]),
            np.array([unit.figures.get(name, nothing)[1] for unit in units]),
        )
        for name in names
    }


def _spread(figure: str, values: Floats, stds: Floats) -> Spread:
    known = np.isfinite(values)
    x, s = values[known], stds[known & np.isfinite(stds)]
    return Spread(
        figure,
        int(x.size),
        float(np.median(x)) if x.size else math.nan,
        float(x.min()) if x.size else math.nan,
        float(x.max()) if x.size else math.nan,
        float(np.std(x, ddof=1)) if x.size > 1 else math.nan,
        float(np.sqrt(np.mean(s**2))) if s.size else math.nan,
    )


def _outlying(units: Sequence[Unit], table: Mapping[str, tuple[Floats, Floats]]) -> tuple[Outlying, ...]:
    """Units out of line, by Rosner's generalised test of several outliers at once (Technometrics 25(2), 1983)."""
    found: list[Outlying] = []
    figures = {name: x for name, (x, _) in table.items() if _enough(x)}
    for name, x in figures.items():
        for i, deviations, p_value in rosner(x, ALARM_RATE / len(figures)):
            unit = units[i]
            p_all = min(1.0, p_value * len(figures))
            found.append(Outlying(unit.serial, unit.source, name, float(x[i]), deviations, p_all))
    return tuple(sorted(found, key=lambda o: (o.p_value, o.serial, o.figure)))


def _enough(x: Floats) -> bool:
    known = x[np.isfinite(x)]
    return bool(known.size >= LEAST_UNITS and np.ptp(known) > 0)


def rosner(x: Floats, level: float) -> list[tuple[int, float, float]]:
    """Outliers of a normal sample.

    Parameters
    ----------
    x : ndarray, shape (n,); NaN are passed over
    level : rate at which a sample without outliers is said to have some

    Returns
    -------
    list of (index, deviations of the others, p-value), the farthest first
    """
    left = list(np.flatnonzero(np.isfinite(x)))
    steps: list[tuple[int, float, float]] = []
    for _ in range(max(1, int(_MOST_OUTLYING * len(left)))):
        values, n = x[left], len(left)
        spread = float(np.std(values, ddof=1))
        if spread == 0.0 or n < 4:
            break
        k = int(np.argmax(np.abs(values - values.mean())))
        ratio = abs(values[k] - values.mean()) / spread
        # Of the others: what the unit itself adds to mean and spread is taken out again.
        t = ratio * math.sqrt(n * (n - 2) / max((n - 1) ** 2 - n * ratio**2, 1e-300))
        p_value = min(1.0, 2 * n * float(stats.t.sf(t, n - 2)))
        steps.append((int(left[k]), float(math.copysign(t, values[k] - values.mean())), p_value))
        left.pop(k)
    last = max((i for i, (_, _, p) in enumerate(steps) if p < level), default=-1)
    return steps[: last + 1]


def _drifts(table: Mapping[str, tuple[Floats, Floats]]) -> tuple[Drift, ...]:
    """Figures that change along the serials, by Kendall's rank test, Holm's procedure over the figures."""
    tested = []
    for name, (values, _) in table.items():
        if _enough(values):
            place = np.flatnonzero(np.isfinite(values)).astype(float)
            x = values[np.isfinite(values)]
            tested.append((float(stats.kendalltau(place, x).pvalue), name, place, x))
    found = []
    corrected = holm(np.array([p_value for p_value, *_ in tested]))
    for p_value, (_, name, place, x) in zip(corrected.tolist(), tested, strict=True):
        if p_value < ALARM_RATE:
            slope = stats.theilslopes(x, place, 0.95)
            found.append(Drift(name, float(slope[0]), float(slope[2]), float(slope[3]), p_value))
    return tuple(sorted(found, key=lambda drift: (drift.p_value, drift.figure)))
