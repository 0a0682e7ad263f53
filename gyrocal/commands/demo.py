"""The whole main job on the virtual bench: acquire, fit, report, and the robot that drives with the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gyrocal.bench.profile import load_profile
from gyrocal.bench.session import AcquireConfig, acquire
from gyrocal.bench.watching import Progress as BenchProgress
from gyrocal.calibration.calibrate import FitConfig, calibrate
from gyrocal.commands.replay import ReplayRequest, replay_to_directory
from gyrocal.commands.report import ReportConfig, write_report
from gyrocal.navigation.drives import DriveRequest, simulate_to_directory
from gyrocal.physics.gyro import rd2100_unit
from gyrocal.records.files import write_atomically
from gyrocal.records.output import check_output
from gyrocal.report.build import ReportResult
from gyrocal.report.truth import TruthComparison, compare_with_truth

#: Share done, 0 to 1, and what is being done.
Progress = Callable[[float, str], None]

PROFILE = "quick"
#: Drives in each direction; the paper has five.
_DRIVES = 5
#: Where the steps begin on the progress bar: about their share of the time.
_STARTS = {"acquire": 0.0, "fit": 0.25, "report": 0.35, "drive": 0.7, "replay": 0.75}


@dataclass(frozen=True)
class DemoConfig:
    """Where to write, and the seed of all noise."""

    out: Path
    seed: int = 1


@dataclass(frozen=True)
class DemoResult:
    """What was made, and the numbers that matter."""

    out: Path
    segments: int
    bench_time_s: float
    report: ReportResult
    truth: TruthComparison
    drives: str

    def to_json(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "out": str(self.out),
            "segments": self.segments,
            "bench_time_s": self.bench_time_s,
            "report": self.report.to_json(),
            "truth": asdict(self.truth),
            "drives": self.drives,
        }


class _Watch:
    """Hands the bench's progress on."""

    def __init__(self, tell: Progress) -> None:
        self._tell = tell

    def progress(self, progress: BenchProgress) -> None:
        """A step of the plan."""
        self._tell(progress.share, progress.step.describe())

    def say(self, text: str) -> None:
        """What an operator should know; the virtual bench has none."""


def run_demo(config: DemoConfig, progress: Progress) -> DemoResult:
    """Acquire a reduced plan, fit it, report it, drive with it; everything below ``config.out``.

    Raises
    ------
    OutputError
        The directory holds files, cannot be written, or the disk is full.
    """
    check_output(config.out)
    run, coefficient_file = config.out / "run", config.out / "coefficients.json"
    drives, replay = config.out / "drives", config.out / "replay"

    summary = acquire(
        AcquireConfig(PROFILE, run, simulate=True, seed=config.seed),
        _Watch(_part(progress, "acquire", "fit")),
    )
    progress(_STARTS["fit"], "fit")
    calibration = calibrate(run, FitConfig())
    write_atomically(coefficient_file, calibration.coefficients.to_text())
    report = write_report(
        ReportConfig(run, coefficient_file, config.out / "report"), _part(progress, "report", "drive")
    )
    unit = load_profile(PROFILE).virtual.unit_seed
    truth = compare_with_truth(
        calibration.coefficients, calibration.fit.half_width_dps(), rd2100_unit(unit).surface
    )

    progress(_STARTS["drive"], "robot drives")
    simulate_to_directory(DriveRequest(drives, config.seed, unit, _DRIVES, "both"))
    request = ReplayRequest(
        logs=sorted(drives.glob("*.csv")),
        robot=drives / "robot.toml",
        out=replay,
        coefficients=coefficient_file,
    )
    result = replay_to_directory(request, _part(progress, "replay", ""))
    return DemoResult(
        out=config.out,
        segments=summary.recorded,
        bench_time_s=summary.bench_time_s,
        report=report,
        truth=truth,
        drives=result.verdict,
    )


def _part(progress: Progress, step: str, following: str) -> Progress:
    """Progress of one step within the whole."""
    low, high = _STARTS[step], _STARTS.get(following, 1.0)
    return lambda share, what: progress(low + share * (high - low), f"{step}: {what}" if what else step)
