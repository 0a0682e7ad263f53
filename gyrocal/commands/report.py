"""`gyrocal report`: a recording and its coefficients, corrected and tested, and all that is drawn of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gyrocal.calibration.material import Progress, gather
from gyrocal.records.output import check_output, write_directory
from gyrocal.report.build import ReportResult, report_files


@dataclass(frozen=True)
class ReportConfig:
    """What to draw, with what, and where to write it."""

    recording: Path
    coefficients: Path
    out: Path
    counts_per_dps: float | None = None
    force_sensor: bool = False


def write_report(config: ReportConfig, progress: Progress) -> ReportResult:
    """Draw everything that the recording carries and write it to ``config.out``.

    Raises
    ------
    InputError, DataError, CoefficientError, OutputError
        Nothing is written then.
    """
    check_output(config.out)
    material = gather(
        config.recording, config.coefficients, config.counts_per_dps, config.force_sensor, progress
    )
    result, files = report_files(material, config.out, progress)
    write_directory(config.out, files)
    progress(1.0, "")
    return result
