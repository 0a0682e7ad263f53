"""A start of `acquire`: profile to bench to plan to run directory, new or carried on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import gyrocal
from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench
from gyrocal.bench.plan import Plan, make_plan, narrowest
from gyrocal.bench.profile import Profile, load_profile, profile_from_dict
from gyrocal.bench.runner import Runner, Summary, Watch
from gyrocal.bench.safety import StopRequests, listening
from gyrocal.bench.virtual.devices import virtual_bench
from gyrocal.errors import DeviceError, InputError, OutputError
from gyrocal.records.journal import Recovered, RunWriter, create_run, is_stillborn, resume_run
from gyrocal.records.run import SCHEMA, Run, Sensor, read_run

#: A simulated run states a fixed instant, so that the same seed gives the same bytes.
_VIRTUAL_UTC = "2000-01-01T00:00:00Z"
#: Bench time between the last thing a dead run wrote and its next start on the virtual bench.
_VIRTUAL_PAUSE_S = 60.0


@dataclass(frozen=True)
class AcquireConfig:
    """What ``gyrocal acquire`` was asked; `seed` None keeps the profile's."""

    profile: str | Path
    out: Path
    simulate: bool = False
    seed: int | None = None
    resume: bool = False


def connect(
    profile: Profile, *, simulate: bool, start_s: float = 0.0, restarts: int = 0
) -> tuple[Bench, Clock]:
    """The bench that a profile names, and the clock that goes with it.

    Raises
    ------
    DeviceError
        The profile names a port for a device that has no driver here.
    """
    for name in ("gyro", "table", "chamber"):
        device = getattr(profile, name).device
        if device != "virtual" and not simulate:
            msg = (
                f'{profile.source}: {name}.device is "{device}", and only "virtual" can be driven yet. '
                "Add --simulate to run this profile on the virtual bench."
            )
            raise DeviceError(msg)
    bench, clock, _ = virtual_bench(profile, start_s=start_s, restarts=restarts)
    return bench, clock


def plan_of(profile: Profile, bench: Bench) -> Plan:
    """The plan of a profile on this bench, checked against its limits; nothing moves."""
    limits = narrowest(profile, bench.table.limits(), bench.chamber.limits())
    start_c = profile.virtual.start_temp_c if bench.describe == "virtual" else profile.safe.chamber_c
    return make_plan(profile, limits, start_c)


def dry_run(config: AcquireConfig) -> tuple[Profile, Plan]:
    """Profile and checked plan, and nothing else."""
    profile = _profile(config, None)
    bench, _ = connect(profile, simulate=config.simulate)
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
        if config.resume and (config.out / "run.json").exists():
            return _carry_on(config, watch, requests)
        if config.resume and config.out.exists() and not is_stillborn(config.out):
            raise InputError(
                f"{config.out}: holds no run.json, so there is no run to carry on. Check the path."
            )
        if (config.out / "run.json").exists():
            msg = f"{config.out}: holds a run already. Add --resume to carry it on, or choose another --out."
            raise OutputError(msg)
        profile = _profile(config, None)
        bench, clock = connect(profile, simulate=config.simulate)
        plan = plan_of(profile, bench)
        with create_run(config.out, _head(profile, bench)) as writer:
            runner = Runner(bench, clock, profile, plan, writer, requests, watch)
            return runner.run("start", steps=len(plan.steps), expected_s=round(plan.expected_s, 3))


def _carry_on(config: AcquireConfig, watch: Watch, requests: StopRequests) -> Summary:
    before = read_run(config.out)
    profile = _profile(config, before)
    _refuse_change(config.out, before, profile)
    writer, found = resume_run(config.out)
    with writer:
        return _run_rest(config, profile, before, writer, found, watch, requests)


def _run_rest(
    config: AcquireConfig,
    profile: Profile,
    before: Run,
    writer: RunWriter,
    found: Recovered,
    watch: Watch,
    requests: StopRequests,
) -> Summary:
    start_s = math.ceil(found.last_t_s) + _VIRTUAL_PAUSE_S
    restarts = found.resumed + 1
    bench, clock = connect(profile, simulate=config.simulate, start_s=start_s, restarts=restarts)
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
    if bench.describe == "virtual":
        details["virtual_world"] = f"restarted at {profile.virtual.start_temp_c:g} deg C, table at rest"
    return runner.run("resume", **details)


def _profile(config: AcquireConfig, before: Run | None) -> Profile:
    """The profile with its seed: the command line's, else that of the run to be carried on, else its own."""
    profile = load_profile(config.profile)
    if config.seed is not None:
        return profile.with_seed(config.seed)
    if before is not None and before.profile is not None and "seed" in before.profile.get("virtual", {}):
        return profile.with_seed(before.profile["virtual"]["seed"])
    return profile


def _refuse_change(path: Path, before: Run, profile: Profile) -> None:
    if before.profile_sha256 == profile.sha256:
        return
    if before.profile is None:
        raise InputError(
            f"{path}/run.json: holds no profile, so gyrocal did not write this run. It cannot be carried on."
        )
    then = profile_from_dict(before.profile, f"{path}/run.json")
    key, old, new = next(iter(_differences(then.raw, profile.raw)), ("", None, None))
    msg = (
        f"{profile.source}: differs from the profile that {path} was begun with: {key} was {old!r} and is {new!r}. "
        "Carry on with the old profile, or start a new run with another --out."
    )
    raise OutputError(msg)


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
    serial = f"virtual-{profile.virtual.unit_seed}" if virtual else spec.serial
    sensor = Sensor(spec.model, serial, spec.rate_range_dps, spec.temp_range_c, spec.sample_rate_hz)
    head: dict[str, Any] = {
        "schema": SCHEMA,
        "created_utc": _VIRTUAL_UTC if virtual else datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "sensor": sensor.to_json(),
        "bench": {
            "devices": bench.describe,
            "table": "virtual" if virtual else profile.bench.table,
            "chamber": "virtual" if virtual else profile.bench.chamber,
            "latitude_deg": profile.bench.latitude_deg,
        },
        "profile": profile.raw,
        "profile_sha256": profile.sha256,
        "software": {"gyrocal": gyrocal.__version__},
    }
    if spec.on_before_s is not None or virtual:
        head["power_on_t_s"] = 0.0 - (spec.on_before_s or 0.0)
    return head
