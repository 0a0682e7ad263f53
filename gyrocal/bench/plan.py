"""The plan: what `acquire` is going to do, as data, checked against every limit before anything moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gyrocal.bench.devices import ChamberLimits, TableLimits
from gyrocal.bench.profile import PlanSpec, Profile
from gyrocal.errors import LimitError
from gyrocal.units import S_PER_MIN

_DEG_PER_TURN = 360.0


@dataclass(frozen=True)
class Bound:
    """A limit and whose it is."""

    value: float
    whose: str


@dataclass(frozen=True)
class Limits:
    """The narrowest of gyro, table, chamber and user, each with its owner."""

    min_rate_dps: Bound
    max_rate_dps: Bound
    min_temp_c: Bound
    max_temp_c: Bound
    max_ramp_c_per_min: Bound
    max_acceleration_dps2: Bound
    max_turns: Bound | None


@dataclass(frozen=True)
class Step:
    """One step, which becomes one segment of the run.

    Attributes
    ----------
    from_c : float
        Set point before a ramp; `chamber_c` otherwise.
    expected_s, latest_s : float
        How long it takes when all goes well, and when every wait runs into its deadline.
    """

    id: int
    kind: str
    rate_dps: float
    chamber_c: float
    from_c: float
    expected_s: float
    latest_s: float

    def describe(self) -> str:
        """A few words for people."""
        at = f" at {self.rate_dps:+.6g} deg/s" if self.rate_dps or self.kind == "rate" else ""
        if self.kind == "ramp":
            return f"ramp {self.from_c:g} to {self.chamber_c:g} °C{at}"
        return f"{self.kind}{at}, {self.chamber_c:g} °C"


@dataclass(frozen=True)
class Plan:
    """All steps with the limits that they keep."""

    steps: tuple[Step, ...]
    limits: Limits

    @property
    def expected_s(self) -> float:
        """Duration when all goes well: soaks may take longer, until the gyro is flat."""
        return sum(step.expected_s for step in self.steps)

    @property
    def latest_s(self) -> float:
        """Duration when every wait runs into its deadline."""
        return sum(step.latest_s for step in self.steps)

    @property
    def turns(self) -> tuple[float, float]:
        """Turns of the table counter-clockwise and clockwise."""
        turns = [step.rate_dps * step.expected_s / _DEG_PER_TURN for step in self.steps]
        return sum(t for t in turns if t > 0), -sum(t for t in turns if t < 0)

    @property
    def winding_turns(self) -> float:
        """Furthest the table gets from where it began: what a cable without slip rings has to bear."""
        turns = np.cumsum([step.rate_dps * step.expected_s / _DEG_PER_TURN for step in self.steps])
        return float(np.max(np.abs(turns), initial=0.0))

    def count(self, kind: str) -> int:
        """Number of steps of a kind."""
        return sum(step.kind == kind for step in self.steps)

    def to_json(self) -> dict[str, Any]:
        """Plain data for ``acquire --dry-run --json``."""
        ccw, cw = self.turns
        return {
            "steps": [asdict(step) for step in self.steps],
            "expected_s": self.expected_s,
            "latest_s": self.latest_s,
            "turns": {"counter_clockwise": ccw, "clockwise": cw, "winding": self.winding_turns},
            "limits": {
                k: v and {"value": v["value"], "whose": v["whose"]} for k, v in asdict(self.limits).items()
            },
        }


def narrowest(profile: Profile, table: TableLimits, chamber: ChamberLimits) -> Limits:
    """Limits of gyro, table, chamber and user; the narrowest of each, with its owner."""
    sensor, user = profile.sensor, profile.limits

    def least(*bounds: Bound | None) -> Bound:
        return min((b for b in bounds if b), key=lambda b: b.value)

    def most(*bounds: Bound | None) -> Bound:
        return max((b for b in bounds if b), key=lambda b: b.value)

    def own(value: float | None, key: str, sign: float = 1.0) -> Bound | None:
        return None if value is None else Bound(sign * value, f"the user (limits.{key})")

    table_says = "the table"
    return Limits(
        min_rate_dps=most(
            Bound(sensor.rate_range_dps[0], "the gyro (sensor.rate_range_dps)"),
            Bound(-table.max_rate_dps, table_says),
            own(user.max_rate_dps, "max_rate_dps", -1.0),
        ),
        max_rate_dps=least(
            Bound(sensor.rate_range_dps[1], "the gyro (sensor.rate_range_dps)"),
            Bound(table.max_rate_dps, table_says),
            own(user.max_rate_dps, "max_rate_dps"),
        ),
        min_temp_c=most(
            Bound(sensor.temp_range_c[0], "the gyro (sensor.temp_range_c)"),
            Bound(chamber.min_temp_c, "the chamber"),
            own(user.min_temp_c, "min_temp_c"),
        ),
        max_temp_c=least(
            Bound(sensor.temp_range_c[1], "the gyro (sensor.temp_range_c)"),
            Bound(chamber.max_temp_c, "the chamber"),
            own(user.max_temp_c, "max_temp_c"),
        ),
        max_ramp_c_per_min=least(
            Bound(chamber.max_ramp_c_per_min, "the chamber"),
            own(user.max_ramp_c_per_min, "max_ramp_c_per_min"),
        ),
        max_acceleration_dps2=Bound(table.max_acceleration_dps2, table_says),
        max_turns=own(user.max_turns, "max_turns"),
    )


def temperature_visits(spec: PlanSpec) -> list[float]:
    """Temperatures in the order of their visits."""
    if spec.temperature_order == "listed":
        return list(spec.temperatures_c)
    up = sorted(spec.temperatures_c)
    if spec.temperature_order == "interleaved":
        # Neighbours are reached from opposite sides, so that a thermal lag cannot pass for a surface.
        return up[::2] + [t for t in reversed(up) if t not in up[::2]]
    return {"up": up, "down": up[::-1], "up_down": up + up[-2::-1]}[spec.temperature_order]


def rates_at_visit(spec: PlanSpec, visit: int) -> list[float]:
    """Rates in their order at the visit number `visit`."""
    rates = list(spec.rates_dps)
    if spec.both_signs:
        rates = [-r for r in reversed(rates) if r > 0] + rates
    if spec.zero_first_and_last:
        rates = [r for r in rates if r != 0]
    if spec.rate_order == "shuffled":
        rng = np.random.default_rng([spec.seed, visit])
        rng.shuffle(rates)
    elif spec.rate_order != "listed":
        up = sorted(rates)
        rates = {"up": up, "down": up[::-1], "up_down": up + up[-2::-1]}[spec.rate_order]
    return [0.0, *rates, 0.0] if spec.zero_first_and_last else rates


def make_plan(profile: Profile, limits: Limits, start_c: float) -> Plan:
    """Expand a profile into steps; the chamber is at `start_c` before the first.

    Raises
    ------
    LimitError
        A step, or the way out to the safe set point, goes beyond a limit.
    """
    draft = [*_draft(profile.plan, start_c)]
    steps = []
    last_rate_dps = 0.0
    for number, (kind, rate_dps, chamber_c, from_c) in enumerate(draft, start=1):
        spin_s = abs(rate_dps - last_rate_dps) / limits.max_acceleration_dps2.value
        expected_s, latest_s = _duration_s(profile, kind, abs(chamber_c - from_c))
        steps.append(
            Step(
                number,
                kind,
                rate_dps,
                chamber_c,
                from_c,
                spin_s + profile.settle.hold_s + expected_s,
                spin_s + profile.settle.deadline_s + latest_s,
            )
        )
        last_rate_dps = rate_dps
    plan = Plan(tuple(steps), limits)
    _check(profile, plan)
    return plan


def _draft(spec: PlanSpec, start_c: float) -> Iterator[tuple[str, float, float, float]]:
    """``(kind, rate, chamber, from)`` of every step."""
    from_c = start_c
    seen: set[float] = set()
    static_at = set(spec.static_at_c or spec.temperatures_c) if spec.static_s > 0 else set()
    for visit, temp_c in enumerate(temperature_visits(spec)):
        ramp_rate_dps = spec.ramp_rates_dps[visit % len(spec.ramp_rates_dps)]
        yield "ramp", ramp_rate_dps, temp_c, from_c
        # The soak keeps the ramp's rate: what the ramp did to the scale factor is seen to decay.
        yield "soak", ramp_rate_dps, temp_c, temp_c
        if temp_c in static_at and temp_c not in seen:
            yield "static", 0.0, temp_c, temp_c
        if spec.rates_dps or spec.zero_first_and_last:
            for rate_dps in rates_at_visit(spec, visit):
                yield "rate", rate_dps, temp_c, temp_c
        seen.add(temp_c)
        from_c = temp_c


def ramp_time_s(profile: Profile, difference_c: float) -> float:
    """Time that the set point needs for a ramp."""
    return abs(difference_c) / profile.ramp.rate_c_per_min * S_PER_MIN


def _duration_s(profile: Profile, kind: str, difference_c: float) -> tuple[float, float]:
    """Expected and latest duration of a step's own part, without bringing the table to rate."""
    if kind == "ramp":
        ramp_s = ramp_time_s(profile, difference_c)
        return ramp_s, ramp_s + profile.ramp.deadline_s
    if kind == "soak":
        return max(profile.soak.time_s, profile.soak.expected_s or 0.0), profile.soak.deadline_s
    length_s = profile.plan.static_s if kind == "static" else profile.plan.dwell_s
    return length_s, length_s


def _check(profile: Profile, plan: Plan) -> None:
    """Refuse what lies outside the limits: each of these once, by the first step that exceeds it."""
    limits = plan.limits
    rates, temps = (limits.min_rate_dps, limits.max_rate_dps), (limits.min_temp_c, limits.max_temp_c)
    wanted: list[tuple[str, float, str, tuple[Bound | None, Bound | None], str]] = [
        entry
        for step in plan.steps
        for entry in (
            ("rate", step.rate_dps, "deg/s", rates, f"step {step.id}, {step.describe()}"),
            ("temperature", step.chamber_c, "°C", temps, f"step {step.id}, {step.describe()}"),
        )
    ]
    ramp = profile.ramp.rate_c_per_min
    wanted += [
        ("temperature", profile.safe.chamber_c, "°C", temps, "safe.chamber_c"),
        ("ramp", ramp, "°C/min", (None, limits.max_ramp_c_per_min), "ramp.rate_c_per_min"),
        ("winding", plan.winding_turns, "turns", (None, limits.max_turns), "all steps"),
    ]
    said: dict[tuple[str, str], str] = {}
    for what, value, unit, bounds, where in wanted:
        for bound, side, beyond in zip(bounds, ("below", "above"), (-1.0, 1.0), strict=True):
            if bound is not None and beyond * (value - bound.value) > 0:
                sentence = f"The {what} of {value:.6g} {unit} ({where}) is {side} {bound.value:.6g} {unit}, the limit of {bound.whose}."
                said.setdefault((what, bound.whose), sentence)
    if said:
        raise LimitError("\n".join(said.values()) + " Nothing has moved; change the plan or the limit.")
