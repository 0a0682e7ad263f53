"""Several recordings against one simulation: what differs between them, in words, as a table and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence

from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.versus.answer import Versus
from gyrocal.diagnosis.versus.between import Between, between_to_json
from gyrocal.report.page import Table
from gyrocal.report.tables import csv_text
from gyrocal.report.words import fixed, listed, parameter_words, range_text
from gyrocal.units import decimals, p_equals, p_text

BETWEEN_JSON = "between.json"

_COLUMNS = ("Of", "Parameter", "Mean, 95 %", "Between the recordings, 95 %", "p", "Differs")


def between_file(answers: Sequence[Versus], found: Sequence[Between]) -> str:
    """Text of ``between.json``."""
    return json.dumps(between_to_json(answers, found), indent=1, allow_nan=False) + "\n"


def between_told(answers: Sequence[Versus], found: Sequence[Between]) -> tuple[str, ...]:
    """What differs between the recordings, and what does not, in sentences."""
    names = listed([a.recording for a in answers])
    differ = [b for b in found if b.differs]
    same = [b for b in found if not b.differs]
    said = [f"{len(answers)} recordings ({names}) are compared in {len(found)} parameters: {BETWEEN_JSON}."]
    for b in differ:
        s = b.spread
        places = decimals(0.5 * (s.spread_interval_95[1] - s.spread_interval_95[0]))
        name = _name(b)
        said.append(
            f"{name[0].upper()}{name[1:]} differs between them, by {fixed(s.spread, places)} {b.unit} rms (95 %: "
            f"{range_text(*s.spread_interval_95)}), {p_equals(s.p_value)}; its mean is {_mean(b)}."
        )
    if same:
        said.append(f"No difference between them is seen in {listed([_name(b) for b in same])}.")
    if differ:
        said.append(
            f"The law that is written is that of {answers[0].recording}; for other units draw what differs from its mean and spread."
        )
    return tuple(said)


def between_table(answers: Sequence[Versus], found: Sequence[Between]) -> Table:
    """A row for each parameter, with its value in each recording."""
    columns = (*_COLUMNS, *(a.recording for a in answers))
    rows = [
        (
            b.of,
            parameter_words(b.name),
            _mean(b),
            f"{range_text(*b.spread.spread_interval_95)} {_unit(b)}",
            p_text(b.spread.p_value),
            "yes" if b.differs else "no",
            *(_value(e) for e in b.estimates),
        )
        for b in found
    ]
    csv = csv_text(
        {
            "of": [b.of for b in found],
            "parameter": [b.name for b in found],
            "unit": [b.unit for b in found],
            "mean": [b.spread.mean for b in found],
            "std_between": [b.spread.spread for b in found],
            "p_value": [b.spread.p_value for b in found],
            "differs": [b.differs for b in found],
        }
    )
    note = "Surface: what the gyro's has beyond the simulation's. Differs: all parameters together tested at 1 %."
    return Table("between", "Between the recordings", columns, rows, csv, note)


def _name(b: Between) -> str:
    return b.name if b.of == "surface" else f"{parameter_words(b.name)} of {b.of}"


def _mean(b: Between) -> str:
    low, high = b.spread.mean_interval_95
    places = decimals(0.5 * (high - low))
    return f"{fixed(b.spread.mean, places)} ({range_text(low, high)}) {_unit(b)}".rstrip()


def _unit(b: Between) -> str:
    return "" if b.unit == "1" else b.unit


def _value(e: Estimate | None) -> str:
    return "-" if e is None else f"{fixed(e.value, decimals(e.std))} ± {fixed(e.std, decimals(e.std))}"
