"""`diagnose`: from a recording to a verdict."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gyrocal.diagnosis.result import Diagnosis
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.records.datasets import DataSetTable
from gyrocal.records.run import Run


@dataclass(frozen=True)
class Options:
    """Choices of a diagnosis.

    Attributes
    ----------
    false_alarm_rate : float
        Family-wise rate at which an effect may be named where there is none.
    seed : int
        Of the Monte Carlo nulls and the bootstrap.
    latitude_deg : float or None
        Of the bench, where the record does not say.
    """

    false_alarm_rate: float = 0.01
    seed: int = 0
    latitude_deg: float | None = None


def diagnose(
    recording: Path | Run | DataSetTable,
    coefficients: Coefficients | None = None,
    options: Options | None = None,
) -> Diagnosis:
    """Compare a recording with its simulated sequence and name the physics that is missing.

    Parameters
    ----------
    recording : Path, Run or DataSetTable
        A run directory, or a table of data sets (read it first where it is in counts).
    coefficients : Coefficients, optional
        The model to simulate from; without it the surface is fitted to the recording first.
    """
    raise NotImplementedError
