"""``gyrocal sim``: which devices are served for a profile, with which options, and the profile lines that reach them."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from gyrocal.bench.clock import Clock
from gyrocal.bench.profile import Profile
from gyrocal.bench.registry import CHAMBERS
from gyrocal.bench.schema import read_table, refuse
from gyrocal.bench.virtual.devices import virtual_bench
from gyrocal.bench.virtual.endpoints import Endpoint
from gyrocal.bench.virtual.server import BenchServer, ServedKinds, make_server
from gyrocal.bench.wiring import ROLES, kinds_of

#: What is served when neither the profile nor the user names a kind: all that a wire can carry is on these.
_USUAL = {"gyro": "kvh-frame-a", "table": "json-lines", "chamber": "espec"}
#: Options without a usable default.
_NEEDED: dict[str, dict[str, Any]] = {
    "kvh-ecore2000": {"lsb_dps": 0.00183},
    "ascii-line": {"columns": ["rate", "temp", "status", "sequence"], "sequence_modulus": 65536},
    "aerosmith": {"decimals": 4},
}


@dataclass(frozen=True)
class Served:
    """A bench on ports: `addresses` by role, and the `snippet` of TOML that puts them into a profile."""

    server: BenchServer
    addresses: dict[str, str]
    snippet: str

    def run(self, stop: threading.Event) -> None:
        """Serve until `stop` is set."""
        self.server.serve(stop)


def serve_profile(
    profile: Profile,
    clock: Clock,
    make_endpoint: Callable[[str], Endpoint],
    kinds: Mapping[str, str | None] | None = None,
) -> Served:
    """The virtual bench of a profile behind ports.

    Parameters
    ----------
    kinds : mapping, optional
        Kind by role; where there is none, that of the profile's device, else one that carries everything.

    Raises
    ------
    ProfileError
        No such kind, or a bad option of it in the profile.
    """
    served = served_kinds(profile, kinds or {})
    bench, _, world = virtual_bench(profile, start_s=clock.now_s())
    addresses: dict[str, str] = {}

    def endpoint(role: str) -> Endpoint:
        made = make_endpoint(role)
        addresses[role] = made.address
        return made

    server = make_server(world, bench, served, clock, endpoint)
    return Served(server, addresses, _toml(snippet_of(profile, served, addresses)))


def served_kinds(profile: Profile, kinds: Mapping[str, str | None]) -> ServedKinds:
    """Kinds and options to serve; see `serve_profile`."""
    chosen = {role: _kind(profile, role, kinds.get(role)) for role in ROLES}
    options = {
        role: read_table(
            kinds_of(role)[kind].options,
            _plain_options(profile, role, kind),
            profile.source,
            f"{role}.options",
        )
        for role, kind in chosen.items()
    }
    return ServedKinds(**chosen, **{f"{role}_options": value for role, value in options.items()})


def snippet_of(profile: Profile, served: ServedKinds, addresses: Mapping[str, str]) -> dict[str, Any]:
    """The sections ``gyro``, ``table`` and ``chamber`` of a profile that uses the served devices."""
    sections: dict[str, Any] = {}
    for role in ROLES:
        kind = getattr(served, role)
        section: dict[str, Any] = {"device": f"{kind}:{addresses[role]}"}
        if role == "chamber" and not CHAMBERS[kind].sets_alarms:
            section["own_alarms_set"] = True
        options = _plain_options(profile, role, kind)
        sections[role] = section | ({"options": options} if options else {})
    return sections


def _kind(profile: Profile, role: str, asked: str | None) -> str:
    named = getattr(profile, role).device.partition(":")[0]
    kind = asked or (named if named in kinds_of(role) else _USUAL[role])
    if kind not in kinds_of(role):
        refuse(profile.source, f"the kind of {role} to serve", kind, "one of " + ", ".join(kinds_of(role)))
    return kind


def _plain_options(profile: Profile, role: str, kind: str) -> dict[str, Any]:
    """Options that the profile gives this kind, or those of the virtual bench: limits, data rate."""
    if getattr(profile, role).device.partition(":")[0] == kind:
        own = dict(getattr(profile, role).options)
    else:
        own = dict(_NEEDED.get(kind, {}))
    known = {f.name for f in fields(kinds_of(role)[kind].options)}
    physical: dict[str, Any] = {"data_rate_hz": profile.sensor.sample_rate_hz}
    if role != "gyro":
        physical = asdict(getattr(profile.virtual, role))
    return {**{name: value for name, value in physical.items() if name in known}, **own}


def _toml(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """TOML of sections whose values are JSON's, which TOML reads alike."""
    lines = []
    for name, section in sections.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in section.items() if key != "options"]
        if "options" in section:
            lines.append(f"[{name}.options]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in section["options"].items()]
        lines.append("")
    return "\n".join(lines)
