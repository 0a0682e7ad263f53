"""`gyrocal diagnose`: a recording to a directory with verdict, page, pictures and coefficient files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

import gyrocal
from gyrocal.bench.profile import profile_from_dict
from gyrocal.calibration.provenance import check_sensor, refuse_compensated
from gyrocal.diagnosis.drive import BLOCK_S
from gyrocal.diagnosis.drive_result import diagnose_drive
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.next_experiment import propose, to_toml
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.errors import InputError, LimitError, ProfileError
from gyrocal.fusion.coefficients import Coefficients, load_coefficients
from gyrocal.records.datasets import DataSetTable, read_data_sets
from gyrocal.records.drive import read_drive_log
from gyrocal.records.robot import read_robot
from gyrocal.records.run import Run, read_run
from gyrocal.report import style
from gyrocal.report.diagnosis import diagnosis_page, figures
from gyrocal.report.diagnosis_drive import drive_figures
from gyrocal.report.output import check_output, write_directory
from gyrocal.report.page import Picture

#: Share done, 0 to 1, and what is being done.
Progress = Callable[[float, str], None]

_PROFILE_FILE = "next_experiment.toml"


@dataclass(frozen=True)
class DiagnoseConfig:
    """What to diagnose, against which model, and where to write it."""

    recording: Path
    out: Path
    coefficients: Path | None = None
    robot: Path | None = None
    counts_per_dps: float | None = None
    bench_hours: float = 8.0
    seed: int = 0
    force_sensor: bool = False


@dataclass(frozen=True)
class DiagnoseResult:
    """The diagnosis, and the files that say it."""

    diagnosis: Diagnosis
    out: Path
    files: tuple[str, ...]


def write_diagnosis(config: DiagnoseConfig, progress: Progress) -> DiagnoseResult:
    """Diagnose a recording and write what was found to ``config.out``.

    Raises
    ------
    InputError, DataError, CoefficientError, OutputError
        Nothing is written then.
    """
    check_output(config.out)
    progress(0.02, "read")
    if config.robot is not None:
        return _write_drive(config, config.robot, progress)
    source = _read(config)
    coefficients, notes = _model(config, source)
    progress(0.1, "examine")
    found = diagnose(source, coefficients, Options(seed=config.seed))
    progress(0.7, "next experiment")
    found = replace(with_next_experiment(found, source, config.bench_hours), notes=(*found.notes, *notes))
    files = diagnosis_files(found, figures(found), _provenance(config), progress)
    write_directory(config.out, files)
    progress(1.0, "")
    return DiagnoseResult(found, config.out, tuple(files))


def _write_drive(config: DiagnoseConfig, robot_file: Path, progress: Progress) -> DiagnoseResult:
    if config.counts_per_dps is not None:
        raise InputError(f"{config.recording}: --counts-per-dps is for tables of data sets. Leave it out.")
    robot = read_robot(robot_file)
    log = read_drive_log(config.recording, robot.metres_per_tick)
    coefficients = None if config.coefficients is None else load_coefficients(config.coefficients)
    progress(0.1, "examine")
    found = diagnose_drive(config.recording.name, log, robot, coefficients, config.seed)
    found = replace(found, diagnosis=replace(found.diagnosis, counted_in=f"block of {BLOCK_S:g} s"))
    drawn = drive_figures(found)
    provenance = _provenance(config) | {"robot": robot_file.name}
    if coefficients is None:
        provenance["coefficients"] = "none: the gyro as logged"
    files = diagnosis_files(found.diagnosis, drawn, provenance, progress)
    write_directory(config.out, files)
    progress(1.0, "")
    return DiagnoseResult(found.diagnosis, config.out, tuple(files))


def _read(config: DiagnoseConfig) -> Run | DataSetTable:
    if config.recording.is_dir():
        if config.counts_per_dps is not None:
            raise InputError(
                f"{config.recording}: a run is in deg/s already; --counts-per-dps is for tables. Leave it out."
            )
        run = read_run(config.recording)
        refuse_compensated(run)
        return run
    return read_data_sets(config.recording, config.counts_per_dps)


def _model(config: DiagnoseConfig, source: Run | DataSetTable) -> tuple[Coefficients | None, tuple[str, ...]]:
    if config.coefficients is None:
        return None, ()
    coefficients = load_coefficients(config.coefficients)
    sensor = source.sensor.to_json() if isinstance(source, Run) else {}
    return coefficients, check_sensor(
        coefficients.sensor, sensor, config.recording, force=config.force_sensor
    )


def with_next_experiment(
    diagnosis: Diagnosis, source: Run | DataSetTable | None, bench_hours: float
) -> Diagnosis:
    """The diagnosis with the experiment that would settle its doubts, checked as `acquire` checks a profile."""
    bench: Mapping[str, Any] = source.profile or {} if isinstance(source, Run) else {}
    proposal = propose(diagnosis, bench, bench_hours)
    if proposal is None:
        return diagnosis
    profile = proposal.profile
    if profile is not None:
        try:
            profile_from_dict(profile, _PROFILE_FILE)
        except (ProfileError, LimitError) as error:
            note = f"no profile could be proposed for this bench: {error}"
            return replace(diagnosis, notes=(*diagnosis.notes, note))
    return replace(
        diagnosis,
        next_experiment=proposal.to_json(),
        sentences=(*diagnosis.sentences, proposal.sentence),
    )


def diagnosis_files(
    diagnosis: Diagnosis,
    drawn: Sequence[tuple[Picture, Figure | None]],
    provenance: Mapping[str, str],
    progress: Progress,
) -> dict[str, bytes | str]:
    """Name to contents of everything that a diagnosis writes."""
    files: dict[str, bytes | str] = {
        "diagnosis.json": json.dumps(diagnosis.to_json(), indent=1, sort_keys=True, allow_nan=False) + "\n"
    }
    if diagnosis.surface is not None:
        files["surface.json"] = diagnosis.surface.to_text()
    if diagnosis.improved is not None:
        files["improved.json"] = diagnosis.improved.to_text()
    if diagnosis.next_experiment is not None and diagnosis.next_experiment.get("profile"):
        files[_PROFILE_FILE] = to_toml(diagnosis.next_experiment["profile"])
    pictures: list[Picture] = []
    for number, (picture, figure) in enumerate(drawn):
        progress(0.75 + 0.2 * number / len(drawn), picture.title)
        if figure is None:
            pictures.append(picture)
            continue
        png = style.render(figure, "png")
        files[f"figures/{picture.name}.png"] = png
        pictures.append(replace(picture, png=png))
    files["diagnosis.html"] = diagnosis_page(diagnosis, pictures, provenance)
    return files


def _provenance(config: DiagnoseConfig) -> dict[str, str]:
    return {
        "recording": config.recording.name,
        "coefficients": "fitted to this recording"
        if config.coefficients is None
        else config.coefficients.name,
        "seed of the nulls": str(config.seed),
        "software": f"gyrocal {gyrocal.__version__}",
    }
