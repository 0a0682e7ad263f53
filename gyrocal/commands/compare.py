"""`gyrocal compare`: runs of a unit, fitted or at rest, read and put beside each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from gyrocal.calibration.calibrate import calibrate, configs
from gyrocal.calibration.compare import Change, compare_at_rest, compare_runs
from gyrocal.calibration.dossier import rest_run
from gyrocal.calibration.provenance import refuse_units


def compare(
    paths: Sequence[Path], counts_per_dps: float | None, tell: Callable[[float, str], None]
) -> tuple[Change, ...]:
    """Changes over the runs: of noise, mean and drift where all of them are at rest.

    Raises
    ------
    InputError, DataError
        A bad run, one alone, runs at rest among others, or of several units.
    """
    each = configs(paths, counts_per_dps)
    refuse_units(paths, "a comparison", unnamed=False)
    at_rest = []
    for number, path in enumerate(paths):
        tell(0.5 * number / len(paths), path.name)
        resting = rest_run(path)
        if resting is None:
            break
        at_rest.append(resting)
    else:
        return compare_at_rest([resting.found for resting in at_rest])
    found = []
    for number, (path, config) in enumerate(zip(paths, each, strict=True)):
        tell(number / len(paths), path.name)
        found.append(calibrate(path, config))
    return compare_runs(found)
