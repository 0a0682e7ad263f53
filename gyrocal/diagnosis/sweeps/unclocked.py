"""What a table without times cannot tell a robot: what depends on how long its temperature took from one data set to the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrocal.diagnosis.model.layers import Model
from gyrocal.diagnosis.model.parts import Part
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.order import LEAP_SETS, SURROGATE_PERIOD_S, leaps_before
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.sweeps.changes import DRIFTS
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.shapes import DRIVERS
from gyrocal.physics.thermal import THERMAL_HYSTERESIS


def leaps(series: Series) -> int:
    """How often the temperature of a table without times leaps from one data set to the next; 0 with times.

    A transient after a leap is as large as the time that it took lets it be, and another run has other soaks: of eight such
    tables the files that had lags were worse than those without in six, by up to a factor of 2.4, and the same in two.
    """
    return 0 if series.has_time else int(np.count_nonzero(leaps_before(series.temp_c)))


def without_clock(model: Model) -> set[str]:
    """Components of a model that go by a clock that its record has not: lags, heat, and what settles since power-on."""
    if not leaps(model.means.series):
        return set()
    laws = {law.name for law in model.laws if _goes_by_clock(law.effect)}
    return laws | {p.name for p in model.parts if p.name in model.components and _part_goes_by_clock(p)}


def lacks_clock(series: Series, effect_id: str) -> bool:
    """Whether a law that a robot evaluates goes by a clock that a record has not."""
    return leaps(series) > 0 and _goes_by_clock(effect_id)


def ask_for_times(series: Series, effects: Sequence[str]) -> list[Remark]:
    """That times would help, where what was found depends on them.

    Parameters
    ----------
    effects : what has a name
    """
    timed = [e for e in effects if e in DRIFTS or lacks_clock(series, e)]
    if not (timed and (count := leaps(series))):
        return []
    # The clock alone knows whether a leap took any time of it.
    counted = LEAP_SETS if np.ptp(series.t_s) > SURROGATE_PERIOD_S * np.ptp(series.set_index) else 0.0
    left_out = [e for e in timed if e not in DRIFTS]
    return [
        Remark(Said.GIVE_TIMES, {"leaps": count, "sets": counted, "effects": timed, "left_out": left_out})
    ]


def _goes_by_clock(effect_id: str) -> bool:
    effect = CATALOGUE[effect_id]
    remembers = effect.has_memory and effect_id != THERMAL_HYSTERESIS.id
    return effect.runtime and (remembers or "since_power_on_s" in effect.needs)


def _part_goes_by_clock(part: Part) -> bool:
    """Whether any of its columns does: what a play remembers it does however long ago that was."""
    drivers = {column.driver for column in part.columns}
    traces = {trace for d in drivers for trace, _ in DRIVERS[d.kind].traces(*d.numbers)}
    return bool(traces - {"play"}) or any(DRIVERS[d.kind].channel == "since_power_on_s" for d in drivers)
