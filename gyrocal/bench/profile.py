"""The bench profile: what is measured, on which devices, in which order, within which limits. TOML, read strictly."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from gyrocal.bench.gyros.stream import StreamLimits
from gyrocal.bench.schema import choice, number, raise_all, read_table, refusal, refuse, refuse_key
from gyrocal.errors import ProfileError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.records.files import parse_toml, read_text
from gyrocal.records.instruments import expired

_DAY_S = 86400.0
_POLICIES = ("unsettled", "fail")


@dataclass(frozen=True, kw_only=True)
class SensorSpec:
    """Who the gyro is, and what its data sheet allows."""

    model: str
    serial: str | None = None
    sample_rate_hz: float = number(0.1, 10000.0, "Hz")
    rate_range_dps: tuple[float, float] = number(-10000.0, 10000.0, "deg/s")
    temp_range_c: tuple[float, float] = number(-100.0, 200.0, "deg C")
    on_before_s: float | None = number(0.0, 1e9, "s", None)


@dataclass(frozen=True)
class DeviceSpec:
    """Where a device is: ``virtual``, ``manual``, or ``kind:port`` with a kind of `gyrocal.bench.registry`.

    `options` are those of the kind; `baud` None is its usual line speed.
    """

    device: str = "virtual"
    baud: int | None = number(50, 10_000_000, "baud", None)
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ChamberSpec(DeviceSpec):
    """A chamber; `own_alarms_set`: its own alarms were set at its panel, where its protocol cannot."""

    own_alarms_set: bool = False


@dataclass(frozen=True)
class BenchSpec:
    """What the run directory says about the bench."""

    table: str = "unknown"
    chamber: str = "unknown"
    latitude_deg: float | None = number(-90.0, 90.0, "deg", None)


@dataclass(frozen=True)
class IdentitySpec:
    """What a certificate says of who measured, with what: names and numbers, and dates as 2027-03-31."""

    operator: str | None = None
    laboratory: str | None = None
    firmware: str | None = None
    table_certificate: str | None = None
    table_due: str | None = None
    thermometer_certificate: str | None = None
    thermometer_due: str | None = None


@dataclass(frozen=True)
class UserLimits:
    """What the user allows on top of what the devices do; None: no limit of the user's own."""

    max_rate_dps: float | None = number(0.001, 10000.0, "deg/s", None)
    min_temp_c: float | None = number(-100.0, 200.0, "deg C", None)
    max_temp_c: float | None = number(-100.0, 200.0, "deg C", None)
    max_ramp_c_per_min: float | None = number(0.01, 100.0, "deg C/min", None)
    max_turns: float | None = number(0.1, 1e9, "turns", None)


@dataclass(frozen=True, kw_only=True)
class PlanSpec:
    """Temperatures and rates, and the order in which they are visited."""

    temperatures_c: tuple[float, ...] = number(-100.0, 200.0, "deg C")
    temperature_order: str = choice("up_down", "interleaved", "up", "down", "listed", default="up_down")
    rates_dps: tuple[float, ...] = number(-10000.0, 10000.0, "deg/s", ())
    both_signs: bool = True
    rate_order: str = choice("shuffled", "up_down", "up", "down", "listed", default="shuffled")
    zero_first_and_last: bool = True
    seed: int = number(0, 2**63 - 1, "", 1)
    dwell_s: float = number(0.1, _DAY_S, "s", 20.0)
    static_s: float = number(0.0, 30 * _DAY_S, "s", 0.0)
    static_at_c: tuple[float, ...] = number(-100.0, 200.0, "deg C", ())
    ramp_rates_dps: tuple[float, ...] = number(-10000.0, 10000.0, "deg/s", (0.0,))


@dataclass(frozen=True)
class SettleSpec:
    """The table is at rate when the measured rate stays within `tolerance_dps` for `hold_s`."""

    tolerance_dps: float = number(1e-5, 10.0, "deg/s", 0.02)
    hold_s: float = number(0.0, 3600.0, "s", 2.0)
    deadline_s: float = number(1.0, _DAY_S, "s", 30.0)
    on_deadline: str = choice(*_POLICIES, default="unsettled")


@dataclass(frozen=True)
class RampSpec:
    """How fast the chamber is taken to the next temperature, and how long after that it may be late."""

    rate_c_per_min: float = number(0.01, 100.0, "deg C/min", 2.0)
    deadline_s: float = number(1.0, _DAY_S, "s", 1800.0)
    on_deadline: str = choice(*_POLICIES, default="unsettled")


@dataclass(frozen=True)
class SoakSpec:
    """Soaked: chamber within `window_c` for all of `time_s`, and the gyro's own temperature flatter than the slope."""

    window_c: float = number(0.01, 20.0, "deg C", 0.5)
    time_s: float = number(0.0, _DAY_S, "s", 1800.0)
    slope_c_per_min: float = number(0.0001, 100.0, "deg C/min", 0.02)
    slope_over_s: float = number(10.0, 7200.0, "s", 300.0)
    expected_s: float | None = number(0.0, 7 * _DAY_S, "s", None)
    deadline_s: float = number(1.0, 7 * _DAY_S, "s", 7200.0)
    on_deadline: str = choice(*_POLICIES, default="unsettled")


@dataclass(frozen=True)
class RecordSpec:
    """How ramps and soaks are averaged, and how often table, chamber and supply are read."""

    averaging_s: float = number(0.01, 3600.0, "s", 1.0)
    bench_period_s: float = number(0.01, 60.0, "s", 1.0)


@dataclass(frozen=True)
class RetrySpec:
    """How often a segment is done again after a failure of a device or its stream, and what comes then."""

    attempts: int = number(0, 20, "", 2)
    wait_s: float = number(0.0, _DAY_S, "s", 60.0)
    then: str = choice("skip", "stop", default="skip")


@dataclass(frozen=True)
class SafeSpec:
    """Where the bench goes at the end, and on every other way out; and what trips the interlocks on the way.

    A gyro that was soaked after the chamber moved has to have moved by `frozen_share` of that; 0: not asked. At rate it
    has to say what the table does, but for `follow_share` of it; 0: not asked. `no_thermometer` confirms that neither
    gyro nor chamber sends a temperature, and that somebody watches it.
    """

    chamber_c: float = number(-100.0, 200.0, "deg C", 25.0)
    standing_dps: float = number(1e-5, 1.0, "deg/s", 0.05)
    stop_deadline_s: float = number(1.0, 3600.0, "s", 30.0)
    over_rate_dps: float | None = number(0.001, 20000.0, "deg/s", None)
    gyro_margin_c: float = number(0.0, 50.0, "deg C", 5.0)
    frozen_share: float = number(0.0, 1.0, "", 0.02)
    follow_share: float = number(0.0, 100.0, "", 0.5)
    no_thermometer: bool = False


@dataclass(frozen=True)
class VirtualGyroSpec:
    """Changes to the drawn unit's noise; None keeps Table I's figure."""

    angle_random_walk_deg_per_rt_h: float | None = number(0.0, 100.0, "deg/sqrt(h)", None)
    bias_instability_deg_per_h: float | None = number(0.0, 10000.0, "deg/h", None)
    lsb_deg: float | None = number(0.0, 1.0, "deg", None)
    temp_lsb_c: float | None = number(0.0, 10.0, "deg C", None)


@dataclass(frozen=True)
class VirtualTableSpec:
    """The virtual rate table: limits, servo wobble, error of the reference rate, encoder."""

    max_rate_dps: float = number(0.1, 10000.0, "deg/s", 400.0)
    max_acceleration_dps2: float = number(0.1, 1e5, "deg/s^2", 50.0)
    wobble_deg: float = number(0.0, 1.0, "deg", 2e-4)
    rate_error_ppm: float = number(0.0, 1e5, "ppm", 10.0)
    encoder_step_deg: float = number(1e-9, 1.0, "deg", 1e-5)


@dataclass(frozen=True)
class VirtualChamberSpec:
    """The virtual chamber: limits, air, compressor ripple, and the gyro's case behind the air."""

    min_temp_c: float = number(-100.0, 200.0, "deg C", -70.0)
    max_temp_c: float = number(-100.0, 300.0, "deg C", 180.0)
    max_ramp_c_per_min: float = number(0.01, 100.0, "deg C/min", 5.0)
    air_s: float = number(1.0, 3600.0, "s", 60.0)
    case_s: float = number(1.0, 36000.0, "s", 400.0)
    ripple_c: float = number(0.0, 10.0, "deg C", 0.1)
    ripple_period_s: float = number(1.0, 7200.0, "s", 240.0)
    noise_c: float = number(0.0, 10.0, "deg C", 0.01)


@dataclass(frozen=True)
class VirtualSupplySpec:
    """The virtual supply: it sags with the table's speed and with the chamber's compressor."""

    nominal_v: float = number(0.0, 60.0, "V", 12.0)
    sag_v: float = number(0.0, 60.0, "V at 100 deg/s", 0.02)
    compressor_v: float = number(0.0, 60.0, "V", 0.02)
    noise_v: float = number(0.0, 10.0, "V", 0.002)


@dataclass(frozen=True)
class VirtualSpec:
    """The virtual bench: which unit, which noise, which further physics."""

    unit_seed: int = number(0, 2**63 - 1, "", 1)
    seed: int = number(0, 2**63 - 1, "", 1)
    start_temp_c: float = number(-100.0, 200.0, "deg C", 23.0)
    gyro: VirtualGyroSpec = VirtualGyroSpec()
    table: VirtualTableSpec = VirtualTableSpec()
    chamber: VirtualChamberSpec = VirtualChamberSpec()
    supply: VirtualSupplySpec = VirtualSupplySpec()
    effects: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Profile:
    """A profile, checked. `raw` is the TOML as read, with the seed that the command line may have set."""

    title: str
    sensor: SensorSpec
    plan: PlanSpec
    gyro: DeviceSpec = DeviceSpec()
    table: DeviceSpec = DeviceSpec()
    chamber: ChamberSpec = ChamberSpec()
    bench: BenchSpec = BenchSpec()
    identity: IdentitySpec = IdentitySpec()
    limits: UserLimits = UserLimits()
    settle: SettleSpec = SettleSpec()
    ramp: RampSpec = RampSpec()
    soak: SoakSpec = SoakSpec()
    record: RecordSpec = RecordSpec()
    stream: StreamLimits = field(default_factory=StreamLimits)
    retry: RetrySpec = RetrySpec()
    safe: SafeSpec = SafeSpec()
    virtual: VirtualSpec = VirtualSpec()
    source: str = field(init=False, default="profile", compare=False)
    raw: Mapping[str, Any] = field(init=False, default_factory=dict, compare=False)

    @property
    def sha256(self) -> str:
        """Digest of the profile as read, in canonical JSON: comments and order do not count."""
        text = json.dumps(self.raw, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def notes(self, today: date) -> tuple[str, ...]:
        """What is allowed, and may still not be what was meant."""
        notes = [
            f"{text}: what is measured now is not traceable" for text in expired(asdict(self.identity), today)
        ]
        if not self.plan.rates_dps:
            notes.append(
                "plan.rates_dps is empty, so that no data set is at rate; such a run carries a bias and its noise, and no "
                "scale factor"
            )
        if self.safe.no_thermometer:
            notes.append(
                "safe.no_thermometer is true: no interlock knows how hot the gyro is, and somebody has to watch it"
            )
        return tuple(f"{self.source}: {note}" for note in notes)

    def with_seed(self, seed: int) -> Profile:
        """The same profile with another seed of the virtual bench's noise."""
        virtual = {**self.raw.get("virtual", {}), "seed": seed}
        return _sealed(
            replace(self, virtual=replace(self.virtual, seed=seed)),
            {**self.raw, "virtual": virtual},
            self.source,
        )


def with_identity(
    profile: Profile, serial: str | None, operator: str | None, bench_file: Path | None
) -> Profile:
    """The same profile with what is known only on the day: serial number, operator, and a file about the bench.

    Raises
    ------
    InputError, ProfileError
        A bench file that cannot be read, or with more in it than the tables `bench` and `identity`.
    """
    raw = {key: dict(value) if isinstance(value, Mapping) else value for key, value in profile.raw.items()}
    if bench_file is not None:
        about = parse_toml(read_text(bench_file), bench_file.name, ProfileError)
        for name, table in about.items():
            if name not in ("bench", "identity"):
                refuse_key(bench_file.name, name, ["bench", "identity"])
            if not isinstance(table, Mapping):
                refuse(bench_file.name, name, table, "a table of keys")
            raw[name] = {**raw.get(name, {}), **table}
    for name, key, value in (("sensor", "serial", serial), ("identity", "operator", operator)):
        if value is not None:
            raw[name] = {**raw.get(name, {}), key: value}
    # The profile was checked when it was read: what is wrong now stands in the bench file.
    checked = profile_from_dict(raw, profile.source if bench_file is None else bench_file.name)
    return _sealed(checked, checked.raw, profile.source)


def profile_directory() -> Path:
    """Where the shipped profiles are: beside this file in a wheel, at the top of an editable tree."""
    packed = Path(__file__).parent / "profiles"
    return packed if packed.is_dir() else Path(__file__).parents[2] / "bench_profiles"


def shipped_profiles() -> dict[str, Path]:
    """Shipped profiles by name."""
    return {path.stem: path for path in sorted(profile_directory().glob("*.toml"))}


def load_profile(name: str | Path) -> Profile:
    """Read a profile by path, or a shipped one by name (``quick`` or ``quick.toml``).

    Raises
    ------
    ProfileError
        No such profile, or a bad key or value in it.
    InputError
        The file may not be read or is not text.
    """
    path = Path(name)
    if not path.exists():
        shipped = shipped_profiles()
        found = shipped.get(path.stem) if path.parent == Path() and path.suffix in ("", ".toml") else None
        if found is None:
            msg = f"{name}: no such profile. Give the path of a .toml file or one of: {', '.join(shipped)}."
            raise ProfileError(msg)
        path = found
    return parse_profile(read_text(path), path.name)


def parse_profile(text: str, source: str) -> Profile:
    """Read and check a profile's text; `source` stands in the messages."""
    return profile_from_dict(parse_toml(text, source, ProfileError), source)


def profile_from_dict(raw: Mapping[str, Any], source: str) -> Profile:
    """Check a profile that was read already, for example the one in ``run.json``."""
    identity = raw.get("identity")
    if isinstance(identity, Mapping):
        # TOML knows dates, and the JSON of a run does not.
        texts = {
            key: value.isoformat() if isinstance(value, date) else value for key, value in identity.items()
        }
        raw = {**raw, "identity": texts}
    profile = read_table(Profile, raw, source)
    effects, wrong = _effects(profile.virtual.effects, source)
    raise_all(_inconsistencies(profile, source) + wrong)
    checked = replace(profile, virtual=replace(profile.virtual, effects=effects))
    return _sealed(checked, raw, source)


def _sealed(profile: Profile, raw: Mapping[str, Any], source: str) -> Profile:
    object.__setattr__(profile, "raw", raw)
    object.__setattr__(profile, "source", source)
    return profile


def _inconsistencies(p: Profile, source: str) -> list[str]:
    """What no single value can say: pairs in order, lists without repeats, rules that fit each other."""
    wrong: list[str] = []

    def refuse(key: str, value: Any, allowed: str) -> None:
        wrong.append(refusal(source, key, value, allowed))

    for key, pair in (("rate_range_dps", p.sensor.rate_range_dps), ("temp_range_c", p.sensor.temp_range_c)):
        if pair[0] >= pair[1]:
            refuse(f"sensor.{key}", list(pair), "the lower number first")
    for key in ("table_due", "thermometer_due"):
        due = getattr(p.identity, key)
        if due is not None and not _is_date(due):
            refuse(f"identity.{key}", due, "a date as 2027-03-31")
    if not p.plan.temperatures_c:
        refuse("plan.temperatures_c", [], "at least one temperature")
    for key, values in (("temperatures_c", p.plan.temperatures_c), ("rates_dps", p.plan.rates_dps)):
        order = p.plan.temperature_order if key == "temperatures_c" else p.plan.rate_order
        if order != "listed" and len(set(values)) < len(values):
            refuse(
                f"plan.{key}",
                list(values),
                f'each value once, unless its order is "listed" ({order} repeats by itself)',
            )
    if p.plan.both_signs and any(rate < 0 for rate in p.plan.rates_dps):
        refuse("plan.rates_dps", list(p.plan.rates_dps), "positive numbers while both_signs is true")
    if not p.plan.ramp_rates_dps:
        refuse("plan.ramp_rates_dps", [], "at least one rate; [0] keeps the table at rest")
    stray = [t for t in p.plan.static_at_c if t not in p.plan.temperatures_c]
    if stray:
        refuse("plan.static_at_c", stray[0], "temperatures that stand in plan.temperatures_c")
    if p.plan.static_at_c and p.plan.static_s == 0:
        refuse("plan.static_s", p.plan.static_s, "more than 0 s where plan.static_at_c is given")
    if (
        not p.plan.rates_dps
        and not p.plan.zero_first_and_last
        and p.plan.static_s == 0
        and len(p.plan.temperatures_c) < 2
    ):
        refuse(
            "plan.rates_dps",
            [],
            "at least one rate, or static_s, or a second temperature: the plan is empty",
        )
    if p.soak.slope_over_s > max(p.soak.time_s, 10.0):
        refuse("soak.slope_over_s", p.soak.slope_over_s, f"at most soak.time_s ({p.soak.time_s:g} s)")
    if p.soak.deadline_s <= p.soak.time_s:
        refuse("soak.deadline_s", p.soak.deadline_s, f"more than soak.time_s ({p.soak.time_s:g} s)")
    if p.settle.deadline_s <= p.settle.hold_s:
        refuse(
            "settle.deadline_s",
            p.settle.deadline_s,
            f"more than settle.hold_s ({p.settle.hold_s:g} s)",
        )
    if p.record.averaging_s * p.sensor.sample_rate_hz < 1:
        least = 1 / p.sensor.sample_rate_hz
        refuse("record.averaging_s", p.record.averaging_s, f"at least one sample ({least:g} s)")
    return wrong


def _is_date(text: str) -> bool:
    try:
        date.fromisoformat(text)
    except ValueError:
        return False
    return True


def _effects(table: Mapping[str, Any], source: str) -> tuple[dict[str, dict[str, float]], list[str]]:
    """Effects with all their parameters (what the profile does not say is the catalogue's usual size), and what is wrong."""
    effects: dict[str, dict[str, float]] = {}
    wrong: list[str] = []
    for effect_id, given in table.items():
        try:
            effects[effect_id] = _effect(effect_id, given, source)
        except ProfileError as error:
            wrong.append(str(error))
    return effects, wrong


def _effect(effect_id: str, given: Any, source: str) -> dict[str, float]:
    key = f"virtual.effects.{effect_id}"
    if effect_id not in CATALOGUE:
        refuse_key(source, key, sorted(CATALOGUE))
    if not isinstance(given, Mapping):
        refuse(source, key, given, "a table of its parameters, {} for their usual sizes")
    known = {p.name: p for p in CATALOGUE[effect_id].parameters}
    for name, value in given.items():
        if name not in known:
            refuse_key(source, f"{key}.{name}", sorted(known))
        p = known[name]
        good = isinstance(value, int | float) and not isinstance(value, bool) and p.low <= value <= p.high
        if not good:
            refuse(source, f"{key}.{name}", value, f"a number from {p.low:g} to {p.high:g} {p.unit}")
    return {**CATALOGUE[effect_id].typical(), **{k: float(v) for k, v in given.items()}}
