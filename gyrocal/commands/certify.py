"""`gyrocal certify`: the runs of a unit fitted, compiled into a dossier, and written as a certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gyrocal.calibration.calibrate import configs
from gyrocal.calibration.dossier import Dossier, RestRun, UnitRun, compile_dossier, rest_run, unit_run
from gyrocal.calibration.limits import read_limits
from gyrocal.calibration.material import Material, examine
from gyrocal.calibration.provenance import refuse_units
from gyrocal.records.output import check_output, write_directory
from gyrocal.records.run import runs_in
from gyrocal.report.certificate import certificate_files


@dataclass(frozen=True)
class CertifyConfig:
    """Runs of one unit in the order in which they were made, or the directory that holds them; limits, and where to write."""

    runs: tuple[Path, ...]
    out: Path
    limits: Path | None = None
    counts_per_dps: float | None = None
    pdf: bool = False


def write_certificate(config: CertifyConfig, tell: Callable[[float, str], None]) -> Dossier:
    """Fit every run, compile the dossier, write it to ``config.out``.

    Raises
    ------
    InputError, DataError, ProfileError, OutputError
        Nothing is written then.
    """
    check_output(config.out)
    limits = read_limits(config.limits) if config.limits else {}
    paths = [run for path in config.runs for run in runs_in(path)]
    refuse_units(paths, "a certificate", unnamed=True)
    runs, at_rest = list[UnitRun](), list[RestRun]()
    for number, (path, how) in enumerate(zip(paths, configs(paths, config.counts_per_dps), strict=True)):
        tell(0.7 * number / len(paths), path.name)
        if (resting := rest_run(path)) is not None:
            at_rest.append(resting)
        else:
            runs.append(unit_run(path, how))
    dossier = compile_dossier(runs, limits, str(config.limits), at_rest)
    tell(0.75, "pictures")
    write_directory(config.out, certificate_files(dossier, _newest(dossier), config.pdf, tell))
    tell(1.0, "")
    return dossier


def _newest(dossier: Dossier) -> Material:
    """The newest run with its own coefficients."""
    newest = dossier.runs[-1].calibration
    return examine(newest.recording, newest.coefficients, newest.fit.scatter, False, lambda share, what: None)
