"""A drive log against a simulated one: which figures of gyro and wheels differ.

No two drives go the same way row by row; each log's encoders, gyro and truth are compared by themselves, and then
what that tells of the two robots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from gyrocal.diagnosis.drive.engine import DriveDiagnosis
from gyrocal.diagnosis.drive.estimates import DriveEstimate
from gyrocal.diagnosis.drive.path_laid import SCALES
from gyrocal.diagnosis.result import Estimate, NamedEffect
from gyrocal.diagnosis.versus.answer import LEVEL, SCHEMA
from gyrocal.inference.multiple import holm
from gyrocal.physics.drive import DRIVE_CATALOGUE

#: Encoder turn over gyro turn, less the scales that the truth is believed about: of it the others are a part.
_RATIO = "effective_track"


@dataclass(frozen=True)
class DriveFigure:
    """A figure of two drives.

    Attributes
    ----------
    lacking : Estimate
        The recording's less the simulation's: what is to be added to the simulation.
    differs : bool
        Whether they differ, all figures together tested at 1 %.
    """

    name: str
    recording: Estimate
    simulation: Estimate
    lacking: Estimate
    p_value: float
    differs: bool

    def to_json(self) -> dict[str, Any]:
        """Entry of ``figures``."""
        return {
            "name": self.name,
            "recording": self.recording.to_json(),
            "simulation": self.simulation.to_json(),
            "lacking": self.lacking.to_json(),
            "p_value": self.p_value,
            "differs": self.differs,
        }


@dataclass(frozen=True)
class DriveVersus:
    """What a simulated robot lacks: figures of both, and effects that are named in one of them alone."""

    recording: str
    simulation: str
    verdict: str
    figures: tuple[DriveFigure, ...]
    effects: tuple[NamedEffect, ...]
    only_simulated: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """``law.json``."""
        return {
            "schema": SCHEMA,
            "recording": self.recording,
            "simulation": self.simulation,
            "verdict": self.verdict,
            "figures": [figure.to_json() for figure in self.figures],
            "effects": [
                {
                    "effect": e.effect,
                    "family": e.family,
                    "equation": DRIVE_CATALOGUE[e.effect].equation,
                    "statement": DRIVE_CATALOGUE[e.effect].statement,
                    "parameters": {name: p.to_json() for name, p in e.parameters.items()},
                }
                for e in self.effects
            ],
            "only_in_simulation": list(self.only_simulated),
        }


def drive_versus(real: DriveDiagnosis, simulated: DriveDiagnosis) -> DriveVersus:
    """Compare the figures of two drives that were diagnosed with the same robot file."""
    own, other = ({e.name: e for e in found.estimates if _known(e)} for found in (real, simulated))
    if {_RATIO, *SCALES} <= own.keys() & other.keys():
        own, other = _with_track(own), _with_track(other)
    compared = []
    for name in (n for n in own if n in other):
        ours, theirs = (Estimate.normal(e[name].value, e[name].std, e[name].unit) for e in (own, other))
        lacking = Estimate.normal(ours.value - theirs.value, float(np.hypot(ours.std, theirs.std)), ours.unit)
        p = float(2.0 * stats.norm.sf(abs(lacking.value) / lacking.std))
        compared.append((name, ours, theirs, lacking, p))
    together = holm(np.array([row[-1] for row in compared]))
    figures = [DriveFigure(*row, bool(p < LEVEL)) for row, p in zip(compared, together, strict=True)]
    here, there = ([e.effect for e in found.diagnosis.effects] for found in (real, simulated))
    alone = tuple(e for e in real.diagnosis.effects if e.effect not in there)
    return DriveVersus(
        real.diagnosis.recording,
        simulated.diagnosis.recording,
        real.diagnosis.verdict,
        tuple(sorted(figures, key=lambda f: f.p_value)),
        alone,
        tuple(e for e in there if e not in here),
    )


def _with_track(figures: Mapping[str, DriveEstimate]) -> dict[str, DriveEstimate]:
    """The figures with the track in place of encoder turn over gyro turn, which holds the scales too, in %."""
    ratio, gyro, wheels = (figures[name] for name in (_RATIO, *SCALES))
    left, wider = (0.0 if scale.named else scale.value / 100.0 for scale in (gyro, wheels))
    value = 100.0 * ((1 + ratio.value / 100.0) * (1 + left) / (1 + wider) - 1.0)
    # As if they were independent, which is more than it is where they are found from each other.
    std = float(np.sqrt(ratio.std**2 + gyro.std**2 + wheels.std**2))
    track = replace(ratio, name="track", value=value, std=std)
    return {n: e for n, e in figures.items() if n != _RATIO} | {"track": track}


def _known(e: DriveEstimate) -> bool:
    """Whether an estimate is one of the robot, and not of how its truth was measured, with a known deviation."""
    return e.path != "truth" and 0.0 < e.std < np.inf
