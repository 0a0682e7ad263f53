"""``gyrocal diagnose``: where a recording departs from the model, and which physics the model lacks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import (
    emit_json,
    emit_list,
    emit_table,
    finite_number,
    json_option,
    progress,
    scale_number,
)
from gyrocal.cli.log_options import drive_options

if TYPE_CHECKING:
    from gyrocal.commands.diagnose import DiagnoseResult


@click.command("diagnose")
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("others", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--coefficients",
    "-c",
    type=click.Path(path_type=Path),
    help="Model to simulate from; without it the surface is fitted to the recording first.",
)
@click.option(
    "--robot", type=click.Path(path_type=Path), help="Robot file: RECORDING is a drive log, not a bench run."
)
@click.option(
    "--simulation",
    type=click.Path(path_type=Path),
    help="What your own simulator wrote of the same plan (a run, a table; with --robot a drive log), or another recording.",
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New directory for the results.")
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Scale of a table in gyro_counts, sign included; as given to `fit`.",
)
@click.option(
    "--bench-hours",
    type=click.FloatRange(min=0.1),
    callback=finite_number,
    default=8.0,
    show_default=True,
    help="Bench time that the next experiment may take.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Of the Monte Carlo nulls and bootstraps.",
)
@click.option("--force-sensor", is_flag=True, help="Accept coefficients of another model or serial number.")
@drive_options
@json_option
def command(
    recording: Path,
    others: tuple[Path, ...],
    coefficients: Path | None,
    robot: Path | None,
    simulation: Path | None,
    out: Path,
    counts_per_dps: float | None,
    bench_hours: float,
    seed: int,
    force_sensor: bool,
    columns: Path | None,
    topics: dict[str, str],
    axis: str,
    as_json: bool,
) -> None:
    """Compare RECORDING with its simulation and name what is missing.

    RECORDING is a run directory, a table of data sets or, with --robot, a drive log; OTHERS are drive logs of the
    same robot, on which is shown what the first one told; with --simulation they are recordings of further units, and
    between.json says which parameters differ between them.

    Writes diagnosis.json, diagnosis.html with pictures, surface.json (the model before), improved.json where
    physics was found (a coefficient file with that physics as terms), next_experiment.toml where an experiment
    would settle a doubt, and of a drive improved_robot.toml where it tells the robot something.

    With --simulation the difference of the two is examined instead, and law.json and law.py say what to add to
    that simulation; law.py is written where it helps on data left out. Of drives law.json holds the figures of
    gyro and wheels that differ.

    \b
    Examples:
      gyrocal diagnose run --out diagnosis
      gyrocal diagnose run --simulation simulated.csv --out versus
    """
    from gyrocal.commands.diagnose import DiagnoseConfig, write_diagnosis
    from gyrocal.records.drive_source import Reading
    from gyrocal.report.sentences import document

    config = DiagnoseConfig(
        recording,
        out,
        coefficients,
        robot,
        counts_per_dps,
        bench_hours,
        seed,
        force_sensor,
        others=others,
        reading=Reading(columns, topics, axis),
        simulation=simulation,
    )
    with progress("diagnose", quiet=as_json) as tell:
        result = write_diagnosis(config, tell)
    if as_json:
        emit_json(document(result.diagnosis))
        return
    _say(result)


def _say(result: DiagnoseResult) -> None:
    from gyrocal.report.sentences import short_data_sentences, short_sentences

    found = result.diagnosis
    data = short_data_sentences(found, result.told)
    emit_list(dict.fromkeys([*result.told, *short_sentences(found)]))
    for table in result.more:
        click.echo("")
        emit_table(table.columns, table.rows, table.title)
    if data:
        click.echo("\nThe data:")
        emit_list(data)
    if "law.py" in result.files:
        click.echo(f"\nAdd to the simulation: {result.out / 'law.py'}")
    click.echo(f"\nDetails, pictures and numbers: open {result.out / 'diagnosis.html'}")
    if "improved.json" in result.files:
        click.echo(
            f"Coefficients with what was found and stays with the gyro, named or not: {result.out / 'improved.json'}"
        )
    if "improved_robot.toml" in result.files:
        click.echo(f"Robot file with what this drive tells: {result.out / 'improved_robot.toml'}")
    if "next_experiment.toml" in result.files:
        click.echo(f"Measure next: gyrocal acquire {result.out / 'next_experiment.toml'} --out RUN")
