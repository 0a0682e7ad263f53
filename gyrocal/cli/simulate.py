"""``gyrocal simulate``: robot drives with the virtual gyro, and the paper's Table II many times over."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import json_option

_OUT = click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Directory to write; new or empty."
)
_SEED = click.option(
    "--seed",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Of everything that is drawn; printed with the result.",
)


@click.group("simulate")
def command() -> None:
    """Simulate robot drives with the virtual bench's gyro.

    Example: gyrocal simulate drive --runs 5 --seed 7 --out drives
    """


@command.command("drive")
@click.option("--path", "path_name", type=click.Choice(["square"]), default="square", show_default=True)
@click.option("--runs", type=click.IntRange(1, 1000), default=5, show_default=True, help="In each direction.")
@click.option("--direction", type=click.Choice(["both", "cw", "ccw"]), default="both", show_default=True)
@click.option(
    "--unit",
    "unit_seed",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Which RD2100: the bench profile's virtual.unit_seed.",
)
@_SEED
@_OUT
@json_option
def drive(
    path_name: str, runs: int, direction: str, unit_seed: int, seed: int, out: Path, as_json: bool
) -> None:
    """Write drive logs of the paper's 210 m square, their robot file, and what is true in them.

    The robot stands for 10 s, drives at 1.5 and 0.8 m/s past eight via points, and comes back: about three
    minutes. Calibrate the same unit with `acquire --simulate` and `fit`, then `replay` these logs.

    Example: gyrocal simulate drive --runs 5 --seed 7 --out drives
    """
    from gyrocal.cli.console import emit_json
    from gyrocal.navigation.drives import DriveRequest, simulate_to_directory
    from gyrocal.units import plural

    note = simulate_to_directory(DriveRequest(out, seed, unit_seed, runs, direction))
    if as_json:
        emit_json(note)
        return
    click.echo(
        f"{out}: {len(note['runs'])} {plural(len(note['runs']), '[log|logs]')} of the {path_name}, robot.toml and simulation.json "
        f"(unit {unit_seed}, seed {seed}, {note['day']['temp_c']:.1f} °C)."
    )
    click.echo(f"Next: gyrocal replay {out}/*.csv --robot {out}/robot.toml --coefficients C --out replay")


@command.command("table2")
@click.option(
    "--experiments", type=click.IntRange(2, 100_000), default=500, show_default=True, help="Ten runs each."
)
@click.option("--workers", type=click.IntRange(1), help="Processes; all cores when left out.")
@click.option(
    "--what-if",
    type=click.IntRange(0, 100_000),
    default=100,
    show_default=True,
    help="Experiments with each physical input changed; 0: none.",
)
@click.option(
    "--world",
    type=click.Choice(["full-scale", "rate", "paper"]),
    default="full-scale",
    show_default=True,
    help="What the data sheet's nonlinearity of 0.5 % is a share of; paper: what would give the paper's table.",
)
@_SEED
@_OUT
@json_option
def table2(
    experiments: int, workers: int | None, what_if: int, world: str, seed: int, out: Path, as_json: bool
) -> None:
    """The paper's Table II and how its three improvement factors scatter over units, days and robots.

    Each experiment draws an RD2100, calibrates it on a simulated bench, draws a robot and a day, drives ten
    squares, and replays them in the four conditions with one set of noise figures. A sensitivity table leads
    from each coefficient and noise to centimetres of return error.

    Example: gyrocal simulate table2 --experiments 500 --seed 1 --out table2
    """
    from gyrocal.cli.console import emit_json, emit_table, progress
    from gyrocal.commands.simulate import table2_to_directory
    from gyrocal.report.navigation_table2 import Table2Request

    with progress("simulate", quiet=as_json) as report:
        result = table2_to_directory(Table2Request(out, experiments, what_if, seed, workers, world), report)
    if as_json:
        emit_json(result.summary)
        return
    for table in result.tables:
        emit_table(table.columns, table.rows, table.title)
        click.echo("")
    click.echo(result.verdict)
    click.echo(f"Page, figures and tables: {out}/table2.html")
