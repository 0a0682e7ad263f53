"""`gyrocal replay`: logs through the runtime, and all that is written of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gyrocal.errors import InputError
from gyrocal.fusion import Coefficients, load_coefficients
from gyrocal.navigation.equip import DriveSource
from gyrocal.navigation.replay import LogReplay, replay_log
from gyrocal.records.drive import DriveBlock
from gyrocal.records.drive_source import Reading, iterate_drive
from gyrocal.records.output import check_output, write_directory
from gyrocal.records.robot import Robot, read_robot
from gyrocal.report.navigation import ReplayResult, replay_files

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class ReplayRequest:
    """What to replay; see `gyrocal replay --help`."""

    logs: Sequence[Path]
    robot: Path
    out: Path
    coefficients: Path | None = None
    reading: Reading = field(default_factory=Reading)
    method: str | None = None
    returns: bool = False
    power_on_t_s: float | None = None
    kind: str = "model"


def replay_to_directory(request: ReplayRequest, report: Report) -> ReplayResult:
    """Replay the logs, then write everything to the output directory: all of it or nothing."""
    robot = read_robot(request.robot)
    coefficients = load_coefficients(request.coefficients) if request.coefficients else None
    sources = _sources(request.logs, robot, request.reading)
    check_output(request.out)
    result = replay_files(
        _replay_all(request, sources, robot, coefficients, report), robot, coefficients, report
    )
    write_directory(request.out, result.files)
    report(1.0, "")
    return result


def _replay_all(
    request: ReplayRequest,
    sources: Sequence[DriveSource],
    robot: Robot,
    coefficients: Coefficients | None,
    report: Report,
) -> list[LogReplay]:
    replays = []
    for k, source in enumerate(sources):
        report(0.7 * k / len(sources), f"replay {source.name}")
        replays.append(
            replay_log(
                source,
                robot,
                coefficients,
                kind=request.kind,
                method=request.method,
                returns=request.returns,
                power_on_t_s=request.power_on_t_s,
            )
        )
    return replays


def _sources(logs: Sequence[Path], robot: Robot, reading: Reading) -> list[DriveSource]:
    sources: list[DriveSource] = []
    for path in logs:
        name = path.stem if path.is_file() else path.name
        if any(s.name == name for s in sources):
            raise InputError(
                f"{path}: another log is called {name!r} too. Rename one: the outputs carry the names."
            )

        def blocks(path: Path = path) -> Iterator[DriveBlock]:
            return iterate_drive(path, robot, reading)

        sources.append(DriveSource(name, blocks))
    return sources
