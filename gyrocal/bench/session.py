"""A start of `acquire`: profile to bench to plan to run directory, new or carried on."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import gyrocal
from gyrocal.bench.capture import RawCapture
from gyrocal.bench.clock import Clock, RealClock
from gyrocal.bench.devices import Bench
from gyrocal.bench.plan import Plan, make_plan, narrowest
from gyrocal.bench.profile import Profile, load_profile, profile_from_dict, with_identity
from gyrocal.bench.runner import Runner
from gyrocal.bench.safety import StopRequests, listening
from gyrocal.bench.transport import Attend, nobody_asks
from gyrocal.bench.virtual.devices import virtual_bench
from gyrocal.bench.watching import Summary, Watch
from gyrocal.bench.wiring import ROLES, Prompt, is_virtual, open_bench
from gyrocal.errors import InputError, InterruptedRunError, OutputError
from gyrocal.records.journal import Recovered, RunWriter, create_run, resume_run
from gyrocal.records.run import SCHEMA, Run, Sensor, read_run

#: A simulated run states a fixed instant, so that the same seed gives the same bytes.
_VIRTUAL_UTC = "2000-01-01T00:00:00Z"
#: Bench time between the last thing a dead run wrote and its next start on the virtual bench.
_VIRTUAL_PAUSE_S = 60.0
#: Nobody carries a run on after a longer pause: by then it is the wall clock that jumped.
_LONGEST_PAUSE_S = 30 * 86400.0
_DEVICES = tuple(f"{role}.device" for role in ROLES)


def _nobody(question: str) -> str:
    raise InterruptedRunError(f"A manual device asks, and nobody is there to answer: {question}")


@dataclass(frozen=True)
class AcquireConfig:
    """What ``gyrocal acquire`` was asked; `seed` None keeps the profile's, `prompt` asks the operator."""

    profile: str | Path
    out: Path
    simulate: bool = False
    seed: int | None = None
    resume: bool = False
    raw: bool = False
    prompt: Prompt = _nobody
    serial: str | None = None
    operator: str | None = None
    bench_file: Path | None = None


def connect(
    profile: Profile,
    *,
    simulate: bool,
    start_s: float = 0.0,
    restarts: int = 0,
    prompt: Prompt = _nobody,
    raw: bool = False,
    attend: Attend = nobody_asks,
) -> tuple[Bench, Clock, RawCapture | None]:
    """The bench that a profile names, the clock that goes with it, and with `raw` the capture of its ports.

    Whoever waits for its real devices, or for time to pass, calls `attend`.

    Raises
    ------
    ProfileError
        A device that does not exist, a bad option of it, or virtual and real devices together.
    """
    if simulate or is_virtual(profile):
        bench, virtual_clock, _ = virtual_bench(profile, start_s=start_s, restarts=restarts)
        return bench, virtual_clock, None
    clock = RealClock(start_s, attend)
    capture = RawCapture(clock) if raw else None
    return open_bench(profile, clock, prompt, capture, attend=attend), clock, capture


@contextlib.contextmanager
def _capturing(capture: RawCapture | None, out: Path, watch: Watch) -> Iterator[None]:
    """Capture raw bytes into the run directory; a capture that fails is told of and ends no run."""
    if capture is None:
        yield
        return
    capture.start(out / "raw")
    try:
        yield
    finally:
        capture.close()
        if capture.failure is not None:
            with contextlib.suppress(OSError):  # nobody looks on any more
                watch.say(f"the raw capture is incomplete: {capture.failure}")


def plan_of(profile: Profile, bench: Bench) -> Plan:
    """The plan of a profile on this bench, checked against its limits; nothing moves."""
    limits = narrowest(profile, bench.table.limits(), bench.chamber.limits())
    start_c = profile.virtual.start_temp_c if bench.describe == "virtual" else profile.safe.chamber_c
    return make_plan(profile, limits, start_c)


def dry_run(config: AcquireConfig) -> tuple[Profile, Plan]:
    """Profile and checked plan, and nothing else."""
    profile = _profile(config, None)
    bench, _, _ = connect(profile, simulate=config.simulate)
    return profile, plan_of(profile, bench)


def acquire(config: AcquireConfig, watch: Watch, requests: StopRequests | None = None) -> Summary:
    """Run a profile and write its run directory, or carry on one that was interrupted.

    Raises
    ------
    ProfileError, LimitError, DeviceError, OutputError, InputError
        Before anything moved: bad profile, plan, device, or output.
    DeviceError, InterlockError, InterruptedRunError, OutputError, StopNotVerifiedError
        During the run; the bench was made safe (or the error says that it may not be).
    """
    requests = requests or StopRequests()
    with listening(requests):
        exists = (config.out / "run.json").exists()
        if config.resume and exists:
            return _carry_on(config, watch, requests)
        if config.resume:
            raise InputError(
                f"{config.out}: holds no run.json, so there is no run to carry on. Check the path, or leave --resume out "
                "to begin one."
            )
        if exists:
            msg = f"{config.out}: holds a run already. Add --resume to carry it on, or choose another --out."
            raise OutputError(msg)
        profile = _profile(config, None)
        bench, clock, capture = connect(
            profile,
            simulate=config.simulate,
            prompt=requests.heeding(config.prompt),
            raw=config.raw,
            attend=requests.attend,
        )
        plan = plan_of(profile, bench)
        for note in profile.notes(datetime.now(UTC).date()):
            watch.say(f"Note: {note}.")
        with create_run(config.out, _head(profile, bench)) as writer, _capturing(capture, config.out, watch):
            runner = Runner(bench, clock, profile, plan, writer, requests, watch)
            return runner.run("start", steps=len(plan.steps), expected_s=round(plan.expected_s, 3))


def _carry_on(config: AcquireConfig, watch: Watch, requests: StopRequests) -> Summary:
    before = read_run(config.out)
    profile = _profile(config, before)
    ports = _new_ports(config.out, before, profile)
    writer, found = resume_run(config.out)
    with writer:
        return _run_rest(config, profile, before, writer, found, watch, requests, ports)


def _run_rest(
    config: AcquireConfig,
    profile: Profile,
    before: Run,
    writer: RunWriter,
    found: Recovered,
    watch: Watch,
    requests: StopRequests,
    ports: Mapping[str, str],
) -> Summary:
    bench, clock, capture = connect(
        profile,
        simulate=config.simulate,
        start_s=_start_again_s(config, profile, before, found),
        restarts=found.resumed + 1,
        prompt=requests.heeding(config.prompt),
        raw=config.raw,
        attend=requests.attend,
    )
    if before.bench.get("devices", bench.describe) != bench.describe:
        msg = f"{config.out}: was begun on a {before.bench['devices']} bench, and this one is {bench.describe}. Use the same devices."
        raise InputError(msg)
    plan = plan_of(profile, bench)
    runner = Runner(
        bench,
        clock,
        profile,
        plan,
        writer,
        requests,
        watch,
        sealed=found.sealed,
        highest_id=found.highest_id,
    )
    left = sum(step.id not in found.sealed for step in plan.steps)
    # A dead program leaves no world behind: the virtual one begins anew, at rest and at its start temperature,
    # with noise of its own. What follows soaks again before it measures.
    details: dict[str, Any] = {
        "left": left,
        "adopted": list(found.adopted),
        "discarded": list(found.discarded),
    }
    if ports:
        details["ports"] = ports
    if bench.describe == "virtual":
        details["virtual_world"] = f"restarted at {profile.virtual.start_temp_c:g} deg C, table at rest"
    with _capturing(capture, config.out, watch):
        return runner.run("resume", **details)


def _start_again_s(config: AcquireConfig, profile: Profile, before: Run, found: Recovered) -> float:
    """Time since the run began, at which it is carried on: later than all that was recorded, whatever the wall clock says."""
    earliest_s = math.ceil(found.last_t_s) + _VIRTUAL_PAUSE_S
    begun = _moment(before.created_utc)
    if config.simulate or is_virtual(profile) or begun is None:
        return earliest_s
    by_clock_s = (datetime.now(UTC) - begun).total_seconds()
    # A computer without a battery clock begins in 1970, or when its system was made.
    believed = found.last_t_s <= by_clock_s <= found.last_t_s + _LONGEST_PAUSE_S
    return max(earliest_s, by_clock_s) if believed else earliest_s


def _moment(text: Any) -> datetime | None:
    """What ``run.json`` says of when the run began; None where that is no time, as after an edit by hand."""
    try:
        moment = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _profile(config: AcquireConfig, before: Run | None) -> Profile:
    """The profile with its seed: the command line's, else that of the run to be carried on, else its own."""
    profile = load_profile(config.profile)
    profile = with_identity(profile, config.serial, config.operator, config.bench_file)
    if config.seed is not None:
        return profile.with_seed(config.seed)
    if before is not None and before.profile is not None:
        then = profile_from_dict(before.profile, f"{config.out}/run.json")
        if "seed" in then.raw.get("virtual", {}):
            return profile.with_seed(then.virtual.seed)
    return profile


def _new_ports(path: Path, before: Run, profile: Profile) -> dict[str, str]:
    """Ports that changed since the run was begun: adapters are numbered anew. Any other change is refused."""
    if before.profile_sha256 == profile.sha256:
        return {}
    if before.profile is None:
        raise InputError(
            f"{path}/run.json: holds no profile, so gyrocal did not write this run. It cannot be carried on."
        )
    then = profile_from_dict(before.profile, f"{path}/run.json")
    changed = list(_differences(then.raw, profile.raw))
    moved = {key: new for key, old, new in changed if key in _DEVICES and _kind(old) == _kind(new)}
    if len(moved) == len(changed):
        return moved
    key, old, new = next(change for change in changed if change[0] not in moved)
    msg = (
        f"{profile.source}: differs from the profile that {path} was begun with: {key} was {old!r} and is {new!r}. "
        "Carry on with the old profile, or start a new run with another --out."
    )
    raise OutputError(msg)


def _kind(device: Any) -> str:
    return str(device).partition(":")[0]


def _differences(
    old: Mapping[str, Any], new: Mapping[str, Any], path: str = ""
) -> list[tuple[str, Any, Any]]:
    """``(dotted key, old, new)`` of everything that differs; None for what is not there."""
    found: list[tuple[str, Any, Any]] = []
    for key in sorted({*old, *new}):
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += _differences(a, b, f"{path}{key}.")
        elif a != b:
            found.append((path + key, a, b))
    return found


def _head(profile: Profile, bench: Bench) -> dict[str, Any]:
    """Contents of ``run.json``."""
    virtual = bench.describe == "virtual"
    spec = profile.sensor
    serial = f"virtual-{spec.serial or profile.virtual.unit_seed}" if virtual else spec.serial
    sensor = Sensor(spec.model, serial, spec.rate_range_dps, spec.temp_range_c, spec.sample_rate_hz)
    head: dict[str, Any] = {
        "schema": SCHEMA,
        "created_utc": _VIRTUAL_UTC if virtual else datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "sensor": sensor.to_json(),
        "bench": {
            "devices": bench.describe,
            "table": "virtual" if virtual else _named(profile.bench.table, profile.table.device),
            "chamber": "virtual" if virtual else _named(profile.bench.chamber, profile.chamber.device),
            "latitude_deg": profile.bench.latitude_deg,
        },
        "identity": {key: value for key, value in asdict(profile.identity).items() if value is not None},
        "simulated": virtual,
        "profile": profile.raw,
        "profile_sha256": profile.sha256,
        "software": {"gyrocal": gyrocal.__version__},
    }
    if spec.on_before_s is not None or virtual:
        head["power_on_t_s"] = 0.0 - (spec.on_before_s or 0.0)
    return head


def _named(name: str, device: str) -> str:
    """What the profile calls a device, or else its kind."""
    return device.partition(":")[0] if name == "unknown" else name
