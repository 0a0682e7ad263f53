"""The experiment that settles a doubt: which plan tells the named effect from what else it could be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.result import Diagnosis, NamedEffect
from gyrocal.physics.catalogue import CATALOGUE, law_of
from gyrocal.physics.rate import DEAD_ZONE
from gyrocal.planning.planned import Design, Reach, designs, duration_h, to_profile
from gyrocal.planning.separation import GOOD_POWER, Separation, repeats_needed, separate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MOST_REPEATS = 10
_USUAL_RAMP_C_PER_MIN = 2.0
_USUAL_REST_C = 25.0
#: Below this the largest rate of a plan is not rounded to a whole number.
_WHOLE_RATES_DPS = 5.0
#: What reaches no farther from zero than this part of the range is not seen by rates that are spread evenly.
_NEAR_ZERO = 0.05
#: Rates that are odd are some of many where they span less than this part of the range.
_SOME_RATES = 0.1
#: A plan that settles a doubt less often is not worth its bench time.
_LEAST_POWER = 0.2
#: Where structure is left unexplained: the plan that shows it best.
_PLAN_FOR = {
    "rate": "fine_rates",
    "temperature": "levels",
    "temperature_rate": "ramps_soaks",
    "temperature_branch": "loops",
    "time": "repeats",
    "time_since_power_on": "power_on",
    "table_angle": "turns",
    "time_since_step": "grid",
    "data_set_index": "grid",
}
#: The same for a record at one rate, where nothing is known of what rates the gyro bears.
_AT_REST = {"time": ("rest",), "data_set_index": ("rest",)}
_RATES_UNKNOWN = "; the table stands, as this record does not say what rates the gyro bears"
_OFF_BEFORE = "leave the gyro off for an hour before, and start the run with its power-on"
_SUPPLY_BY_HAND = "step the supply voltage by a few tenths of a volt between data sets, in random order"


@dataclass(frozen=True)
class Proposal:
    """An experiment, and what it will tell."""

    sentence: str
    separates: tuple[str, ...]
    profile: dict[str, Any] | None
    bench_hours: float | None
    expected_power: float | None
    separations: tuple[Separation, ...]
    by_hand: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Entry ``next_experiment`` of the diagnosis."""
        return {
            "statement": self.sentence,
            "separates": list(self.separates),
            "profile": self.profile,
            "bench_hours": self.bench_hours,
            "expected_power": self.expected_power,
            "pairs": [
                {
                    "against": s.other,
                    "d_prime": s.d_prime,
                    "d_prime_needed": s.d_prime_needed,
                    "captured_share": s.captured,
                    "power": s.power,
                    "power_if_other": None if s.if_other is None else s.if_other.power,
                }
                for s in self.separations
            ],
            "by_hand": list(self.by_hand),
        }


def propose(diagnosis: Diagnosis, bench: Mapping[str, Any], bench_hours: float) -> Proposal | None:
    """The plan that separates the strongest unsettled class best, or shows best what is left; None without doubt.

    Parameters
    ----------
    bench : mapping
        The profile that the recording was made with, as read; empty if unknown.
    bench_hours : float
        Bench time that the plan may take.
    """
    if diagnosis.surface is None:
        return None
    sensor = {**diagnosis.surface.sensor, **bench.get("sensor", {})}
    reach = _reach(diagnosis, sensor, bench)
    unsettled = [e for e in diagnosis.effects if e.alternatives]
    if unsettled:
        return _separating(diagnosis, unsettled[0], reach, sensor, bench, bench_hours)
    remaining = [p.coordinate for p in diagnosis.located if p.remains]
    if diagnosis.verdict in ("partly_explained", "unexplained"):
        remaining = remaining or [p.coordinate for p in diagnosis.located]
        return _showing(remaining, reach, sensor, bench, bench_hours)
    return None


def _reach(diagnosis: Diagnosis, sensor: Mapping[str, Any], bench: Mapping[str, Any]) -> Reach:
    """What the record, the gyro and the bench's user allow, whichever is least."""
    limits = bench.get("limits", {})
    low, high = _temperatures(diagnosis)
    gyro_low, gyro_high = sensor.get("temp_range_c", (-np.inf, np.inf))
    low = max(low, gyro_low, limits.get("min_temp_c", -np.inf))
    high = min(high, gyro_high, limits.get("max_temp_c", np.inf))
    # Whole numbers inside the calibrated range: a set point that noise has widened could be out of limits.
    whole = float(np.ceil(low + 0.5)), float(np.floor(high - 0.5))
    low, high = whole if whole[0] <= whole[1] else (0.5 * (low + high),) * 2
    ramp = float(bench.get("ramp", {}).get("rate_c_per_min", _USUAL_RAMP_C_PER_MIN))
    fast = float(limits.get("max_ramp_c_per_min", ramp))
    # Where the gyro was when the run began is where the chamber rests.
    rest = float(np.round(diagnosis.rows.temp_c[0])) if diagnosis.rows is not None else _USUAL_REST_C
    sizes = () if diagnosis.rows is None else np.unique(np.abs(np.round(diagnosis.rows.rate_dps, 3))).tolist()
    largest = _largest_rate(diagnosis, sensor, limits)
    near = _near_zero_dps(diagnosis, sizes)
    near = near if near < _NEAR_ZERO * largest else 0.0
    return Reach(
        largest, low, high, min(ramp, fast), fast, rest, tuple(sizes), near, _odd_dps(diagnosis, largest)
    )


def _odd_dps(diagnosis: Diagnosis, largest_dps: float) -> tuple[float, ...]:
    """The sizes of rate between which something is left; empty where that is not in some rates of many."""
    left = next((p for p in diagnosis.located if p.remains and p.coordinate == "rate"), None)
    if left is None or left.low is None or left.high is None:
        return ()
    narrow = left.high - left.low < _SOME_RATES * largest_dps
    return tuple(sorted((abs(left.low), abs(left.high)))) if narrow else ()


def _near_zero_dps(diagnosis: Diagnosis, sizes_dps: Sequence[float]) -> float:
    """How far from zero rate what is named or left there reaches; 0 where nothing does."""
    zone = next((e.parameters for e in diagnosis.effects if e.effect == DEAD_ZONE.id), {})
    if "width_dps" in zone:
        return zone["width_dps"].value
    left = next((p for p in diagnosis.located if p.remains and p.coordinate == "rate"), None)
    if left is None or left.low is None or left.high is None:
        return 0.0
    # At rest nothing is known below the least rate of the record.
    least = min((size for size in sizes_dps if size > 0.0), default=0.0)
    return max(abs(left.low), abs(left.high), least)


def _temperatures(diagnosis: Diagnosis) -> tuple[float, float]:
    if diagnosis.surface is not None:
        return diagnosis.surface.valid.temp_c
    return -10.0, 50.0


def _largest_rate(diagnosis: Diagnosis, sensor: Mapping[str, Any], limits: Mapping[str, Any]) -> float:
    """Largest rate of the record, within all limits; 0 where neither record nor data sheet know one."""
    known = sensor.get("rate_range_dps")
    rows = diagnosis.rows
    if rows is not None and np.ptp(rows.rate_dps) > 0:
        largest = float(np.max(np.abs(rows.rate_dps)))
    elif known is not None:
        largest = min(map(abs, known))
    else:
        return 0.0
    if known is not None:
        largest = min(largest, *map(abs, known))
    largest = min(largest, limits.get("max_rate_dps", np.inf))
    return float(np.floor(largest + 0.01)) if largest >= _WHOLE_RATES_DPS else round(largest, 3)


def _separating(
    diagnosis: Diagnosis,
    effect: NamedEffect,
    reach: Reach,
    sensor: Mapping[str, Any],
    bench: Mapping[str, Any],
    bench_hours: float,
) -> Proposal:
    others = [a.effect for a in effect.alternatives]
    unlike = [o for o in others if law_of(o) != law_of(effect.effect)]
    on_bench = [o for o in unlike if CATALOGUE[o].family != "sampling"]
    doubtful = {effect.effect, *others}
    by_hand = [
        text
        for known in CATALOGUE.values()
        for other, text in known.search.told_apart.items()
        if {known.id, other} <= doubtful
    ]
    if "supply" in (CATALOGUE[e].seen_in for e in (effect.effect, *others)):
        by_hand.append(_SUPPLY_BY_HAND)
    best: tuple[Design, tuple[Separation, ...]] | None = None
    if on_bench:
        best = best_design(diagnosis, effect, on_bench, reach, bench_hours)
    names = (effect.effect, *others)
    if best is None or _hopeless(best[1]):
        remedy = "; ".join(by_hand) or f"no plan within {bench_hours:g} h of bench time separates them"
        if best is not None:
            remedy += f" (the best of them, {best[0].purpose}, with a probability of {_power(best[1]):.0%})"
        return Proposal(f"To tell {_either(names)}: {remedy}.", names, None, None, None, (), tuple(by_hand))
    design, separations = best
    if design.from_power_on:
        by_hand.append(_OFF_BEFORE)
    power = _power(separations)
    hours = duration_h(design, reach)
    unknown = _RATES_UNKNOWN if reach.rate_dps == 0 else ""
    sentence = f"To tell {_either(names)}, measure {design.purpose} ({hours:.1f} h{unknown}): expected to reach 20 : 1 with a probability of {power:.0%}"
    times = repeats_needed(separations)
    if power < GOOD_POWER - 0.005:
        sentence += (
            f", or {GOOD_POWER:.0%} when it is measured {times} times"
            if times <= _MOST_REPEATS
            else ", and no bench time in reach would raise that to certainty"
        )
    sentence += f"; by hand: {'; '.join(by_hand)}." if by_hand else "."
    return Proposal(
        sentence,
        names,
        to_profile(design, reach, sensor, bench),
        round(hours, 3),
        round(power, 4),
        separations,
        tuple(by_hand),
    )


def _power(separations: Sequence[Separation]) -> float:
    """Probability that the worst pair is settled."""
    return min(s.expected_power for s in separations)


def _hopeless(separations: Sequence[Separation]) -> bool:
    """Whether a plan settles hardly anything, however often it is repeated."""
    return _power(separations) < _LEAST_POWER and repeats_needed(separations) > _MOST_REPEATS


def _either(names: Sequence[str]) -> str:
    return f"{names[0]} from {' and '.join(names[1:])}"


def _showing(
    remaining: Sequence[str],
    reach: Reach,
    sensor: Mapping[str, Any],
    bench: Mapping[str, Any],
    bench_hours: float,
) -> Proposal | None:
    """A plan that resolves the coordinate where unexplained structure lives."""
    if not remaining:
        return None
    place = remaining[0]
    if place == "supply":
        return Proposal(
            f"To see what has no name over supply: {_SUPPLY_BY_HAND}.",
            (),
            None,
            None,
            None,
            (),
            (_SUPPLY_BY_HAND,),
        )
    named = {d.name: d for d in designs(reach) if duration_h(d, reach) <= bench_hours}
    plan = "near_zero" if place == "rate" and reach.near_dps > 0.0 else _PLAN_FOR.get(place, "grid")
    wanted = [plan, *(_AT_REST.get(place, ()) if reach.rate_dps == 0 else ())]
    design = next((named[name] for name in wanted if name in named), None)
    if design is None:
        return None
    hours = duration_h(design, reach)
    unknown = _RATES_UNKNOWN if reach.rate_dps == 0 else ""
    sentence = f"To see what has no name over {place.replace('_', ' ')}, measure {design.purpose} ({hours:.1f} h{unknown})."
    return Proposal(sentence, (), to_profile(design, reach, sensor, bench), round(hours, 3), None, (), ())


def best_design(
    diagnosis: Diagnosis, effect: NamedEffect, others: Sequence[str], reach: Reach, bench_hours: float
) -> tuple[Design, tuple[Separation, ...]] | None:
    """The shortest design with good power against every other effect, else the one of most power."""
    found: list[tuple[float, float, Design, tuple[Separation, ...]]] = []
    of_rate = any(CATALOGUE[e].seen_in == "rate" for e in (effect.effect, *others))
    for design in designs(reach):
        hours = duration_h(design, reach)
        if hours <= bench_hours and (of_rate or not design.about_rate):
            pairs = separate(diagnosis, effect, others, design, reach)
            found.append((_power(pairs), hours, design, pairs))
    good = [f for f in found if f[0] >= GOOD_POWER]
    if good:
        return min(good, key=lambda f: f[1])[2:]
    return max(found, key=lambda f: f[0])[2:] if found else None


def to_toml(profile: Mapping[str, Any]) -> str:
    """TOML text of a profile: plain keys first, then its tables."""
    return "\n".join(_toml_lines(profile, "")) + "\n"


def _toml_lines(table: Mapping[str, Any], path: str) -> list[str]:
    plain = {k: v for k, v in table.items() if not isinstance(v, Mapping)}
    nested = {k: v for k, v in table.items() if isinstance(v, Mapping)}
    lines = [f"{key} = {_toml_value(value)}" for key, value in plain.items()]
    for key, value in nested.items():
        name = f"{path}.{key}" if path else key
        lines += ["", f"[{name}]", *_toml_lines(value, name)]
    return lines


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return repr(value)
