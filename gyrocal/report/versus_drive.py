"""`gyrocal diagnose --robot --simulation`: what a simulated drive lacks, in words and as JSON."""

from __future__ import annotations

import json

from gyrocal.diagnosis.versus.drive import DriveFigure, DriveVersus
from gyrocal.physics.drive import SKID_SLIP
from gyrocal.report.words import estimate_text, listed, parameter_words


def drive_law_file(found: DriveVersus) -> str:
    """Text of ``law.json``."""
    return json.dumps(found.to_json(), indent=1, sort_keys=True) + "\n"


def drive_told(found: DriveVersus) -> tuple[str, ...]:
    """What differs between the two drives, and what does not, in sentences."""
    differ = [f for f in found.figures if f.differs]
    same = [f for f in found.figures if not f.differs]
    said = [
        f"No row of a drive has a partner in another: {found.recording} and {found.simulation} are compared in the figures "
        "that each tells of its robot."
    ]
    said += [_differs(f) for f in differ]
    if same:
        said.append(f"No difference is seen in {listed([_words(f) for f in same])}.")
    # A track that differs is what slip in turns does.
    shown = {SKID_SLIP.id if f.name in ("track", "effective_track") else f.name for f in differ}
    alone = [e.effect for e in found.effects if e.effect not in shown]
    if alone:
        said.append(f"Named in {found.recording} and not in {found.simulation}: {listed(alone)}.")
    if found.only_simulated:
        said.append(
            f"Named in {found.simulation} and not in {found.recording}: {listed(list(found.only_simulated))}. Take it out of the "
            "simulation, or record what shows it."
        )
    return tuple(said)


def _differs(f: DriveFigure) -> str:
    name = _words(f)
    return (
        f"{name[0].upper()}{name[1:]} is {estimate_text(f.recording)}, in the simulation {estimate_text(f.simulation)}: add "
        f"{estimate_text(f.lacking)}."
    )


def _words(f: DriveFigure) -> str:
    return parameter_words(f.name).replace("_", " ")
