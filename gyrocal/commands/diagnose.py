"""`gyrocal diagnose`: a recording to a directory with verdict, page, pictures and coefficient files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

import gyrocal
from gyrocal.bench.profile import profile_from_dict
from gyrocal.calibration.noise import noise_at_rest
from gyrocal.calibration.provenance import check_sensor, fitted_to, refuse_compensated, refuse_twice
from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.diagnosis.engine import Options, diagnose, series_of
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.diagnosis.versus.answer import only_surface, versus
from gyrocal.diagnosis.versus.between import between
from gyrocal.diagnosis.versus.drive import drive_versus
from gyrocal.errors import InputError, LimitError, ProfileError
from gyrocal.fusion.coefficients import Coefficients, load_coefficients
from gyrocal.planning.next_experiment import propose, to_toml
from gyrocal.records.datasets import DataSetTable, nominal_scales, read_data_sets
from gyrocal.records.drive_source import Reading, read_drive
from gyrocal.records.output import check_output, write_directory
from gyrocal.records.robot import format_robot, read_robot
from gyrocal.records.run import Run, read_run
from gyrocal.report import style
from gyrocal.report.between import BETWEEN_JSON, between_file, between_table, between_told
from gyrocal.report.diagnosis import diagnosis_page, figures
from gyrocal.report.diagnosis_drive import drive_figures
from gyrocal.report.drive_words import drive_sentences
from gyrocal.report.page import Picture, Table
from gyrocal.report.sentences import document
from gyrocal.report.versus import LAW_JSON, law_files, told
from gyrocal.report.versus_drive import drive_law_file, drive_told
from gyrocal.report.versus_figure import versus_picture

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
    #: Drive logs of the same robot that the figures are shown on and not fitted to; or, with a simulation, recordings
    #: of further units.
    others: tuple[Path, ...] = ()
    reading: Reading = field(default_factory=Reading)
    simulation: Path | None = None


@dataclass(frozen=True)
class DiagnoseResult:
    """The diagnosis, and the files that say it."""

    diagnosis: Diagnosis
    out: Path
    files: tuple[str, ...]
    told: tuple[str, ...] = ()
    more: tuple[Table, ...] = ()


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
    if config.others and config.simulation is None:
        raise InputError(
            f"{config.others[0]}: several recordings are compared with a simulation, or are drive logs. State --simulation "
            "or --robot."
        )
    if config.reading != Reading():
        raise InputError(
            f"{config.recording}: --columns, --topic and --axis are for drive logs. State the robot file with --robot."
        )
    if config.simulation is not None:
        return _write_versus(config, config.simulation, progress)
    source = _read(config.recording, config.counts_per_dps)
    coefficients, notes = _model(config, source)
    progress(0.1, "examine")
    found = diagnose(source, coefficients, Options(seed=config.seed))
    progress(0.7, "next experiment")
    found = replace(with_next_experiment(found, source, config.bench_hours), notes=(*found.notes, *notes))
    found = with_noise_at_rest(_with_source(found, config), source)
    files = diagnosis_files(found, figures(found), _provenance(config), progress)
    write_directory(config.out, files)
    progress(1.0, "")
    return DiagnoseResult(found, config.out, tuple(files))


def with_noise_at_rest(found: Diagnosis, source: Run | DataSetTable) -> Diagnosis:
    """The diagnosis with the noise figures that `fit` and `report` give for the same record, where it has samples at rest.

    What the samples at rest do not resolve stays what the model of the whole recording says.
    """
    if found.noise is None or not isinstance(source, Run):
        return found
    at_rest = noise_at_rest(source).figures
    walk, bias = (at_rest[name].value for name in ("angle_random_walk", "bias_instability"))
    noise = replace(
        found.noise,
        angle_random_walk_deg_per_rt_h=found.noise.angle_random_walk_deg_per_rt_h if walk is None else walk,
        bias_instability_deg_per_h=found.noise.bias_instability_deg_per_h if bias is None else bias,
    )
    return replace(found, noise=noise)


def _with_source(found: Diagnosis, config: DiagnoseConfig) -> Diagnosis:
    """The answer with the recording in the provenance of what was fitted to it."""
    fitted_here = config.coefficients is None
    return replace(
        found,
        surface=fitted_to(found.surface, config.recording)
        if fitted_here and found.surface
        else found.surface,
        improved=fitted_to(found.improved, config.recording) if found.improved else None,
    )


def _write_drive(config: DiagnoseConfig, robot_file: Path, progress: Progress) -> DiagnoseResult:
    if config.counts_per_dps is not None:
        raise InputError(f"{config.recording}: --counts-per-dps is for tables of data sets. Leave it out.")
    if config.coefficients is not None and config.simulation is not None:
        raise InputError(
            f"{config.coefficients}: a drive is compared with its simulation as both were logged. Leave --coefficients out."
        )
    robot = read_robot(robot_file)
    log = read_drive(config.recording, robot, config.reading)
    coefficients = None if config.coefficients is None else load_coefficients(config.coefficients)
    progress(0.1, "examine")
    others = [(path.name, read_drive(path, robot, config.reading)) for path in config.others]
    found = diagnose_drive(config.recording.name, log, robot, coefficients, others)
    said: tuple[str, ...] = ()
    extra: dict[str, bytes | str] = {}
    if config.simulation is not None:
        simulated = read_drive(config.simulation, robot, config.reading)
        compared = drive_versus(found, diagnose_drive(config.simulation.name, simulated, robot))
        said, extra = drive_told(compared), {LAW_JSON: drive_law_file(compared)}
    diagnosis = replace(
        found.diagnosis, sentences=drive_sentences(found), notes=(*said, *found.diagnosis.notes)
    )
    drawn = drive_figures(found)
    provenance = _provenance(config) | {"robot": robot_file.name}
    if coefficients is None:
        provenance["coefficients"] = "none: the gyro as logged"
    if config.simulation is not None:
        provenance["simulation"] = config.simulation.name
    files = extra | diagnosis_files(diagnosis, drawn, provenance, progress, told=said)
    if found.robot is not None:
        files["improved_robot.toml"] = format_robot(found.robot)
    write_directory(config.out, files)
    progress(1.0, "")
    return DiagnoseResult(diagnosis, config.out, tuple(files), said)


def _write_versus(config: DiagnoseConfig, simulation: Path, progress: Progress) -> DiagnoseResult:
    if config.coefficients is not None:
        raise InputError(
            f"{config.coefficients}: --simulation says what the recording is compared with. Leave --coefficients out."
        )
    refuse_twice([config.recording, *config.others])
    paths = [config.recording, simulation, *config.others]
    first, second, *further = (
        _read(path, scale)
        for path, scale in zip(paths, nominal_scales(paths, config.counts_per_dps), strict=True)
    )
    recording, simulated = series_of(first, second), series_of(second, first)
    others = [series_of(other, second) for other in further]
    progress(0.1, "match and examine")
    options = Options(seed=config.seed)
    whole = cache(partial(only_surface, simulated, options))
    answer = versus(recording, simulated, options, whole)
    said, files, more = told(answer), law_files(answer), []
    if others:
        answers = [answer]
        for number, other in enumerate(others, 1):
            progress(0.1 + 0.6 * number / (len(others) + 1), other.name)
            answers.append(versus(other, simulated, replace(options, heldout=False), whole))
        compared = between(answers)
        said = (*said, *between_told(answers, compared))
        files[BETWEEN_JSON] = between_file(answers, compared)
        more = [between_table(answers, compared)]
    # Coefficients of the difference are none of a gyro, and no robot must take them for such.
    found = replace(answer.diagnosis, surface=None, improved=None, notes=(*said, *answer.diagnosis.notes))
    drawn = figures(found, versus_picture(answer))
    provenance = _provenance(config) | {"coefficients": "none", "simulation": simulation.name}
    files |= diagnosis_files(found, drawn, provenance, progress, more, said[0], said)
    write_directory(config.out, files)
    progress(1.0, "")
    return DiagnoseResult(found, config.out, tuple(files), said, tuple(more))


def _read(path: Path, counts_per_dps: float | None) -> Run | DataSetTable:
    if path.is_dir():
        if counts_per_dps is not None:
            raise InputError(
                f"{path}: a run is in deg/s already; --counts-per-dps is for tables. Leave it out."
            )
        run = read_run(path)
        refuse_compensated(run)
        return run
    return read_data_sets(path, counts_per_dps)


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
    return replace(diagnosis, next_experiment=proposal.to_json())


def diagnosis_files(
    diagnosis: Diagnosis,
    drawn: Sequence[tuple[Picture, Figure | None]],
    provenance: Mapping[str, str],
    progress: Progress,
    more: Sequence[Table] = (),
    verdict: str = "",
    told: Sequence[str] = (),
) -> dict[str, bytes | str]:
    """Name to contents of everything that a diagnosis writes; the last three as of `diagnosis_page`."""
    files: dict[str, bytes | str] = {
        "diagnosis.json": json.dumps(document(diagnosis), indent=1, sort_keys=True, allow_nan=False) + "\n"
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
    files["diagnosis.html"] = diagnosis_page(diagnosis, pictures, provenance, more, verdict, told)
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
