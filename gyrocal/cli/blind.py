"""``gyrocal blind``: hidden physics, sealed answers."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_table, json_option, progress
from gyrocal.cli.filling import filling

_COLUMNS = ("", "Trials", "Share, 95 % interval")


@click.command("blind")
@click.option("--trials", type=click.IntRange(min=1), default=20, show_default=True, help="Number of runs.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of everything that is drawn."
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New directory for the results.")
@click.option(
    "--kind",
    type=click.Choice(["single", "layers", "laws", "sensors", "nulls"]),
    default="single",
    show_default=True,
    help="What is hidden: single effects on your profile, or recordings that are made up whole.",
)
@click.option(
    "--profile", help="For single: your profile (.toml), or the name of a shipped one (quick unless given)."
)
@json_option
def command(trials: int, seed: int, out: Path, kind: str, profile: str | None, as_json: bool) -> None:
    """Hide physics in recordings, and let `diagnose` find it.

    single: a random effect, several, or none, in virtual runs of your profile. The virtual bench shares its
    formulas with the finder, so this proves less than the other kinds do, whose code shares nothing with it.

    layers: three to five effects one over the other. laws: laws that only resemble the catalogue's. sensors: MEMS,
    open loop, navigation grade, coarse thermometers and outputs. nulls: nothing, under awkward noise or plans.
    Each has a second run of the same gyro on another plan, without noise, on which improved.json is judged.

    Each answer is sealed by a hash before the diagnosis and opened after. Writes blind.json, blind.html and
    commitments.txt, and of what is made up the recordings.

    Example: gyrocal blind --trials 20 --seed 1 --out blind
    Example: gyrocal blind --kind layers --trials 8 --seed 1 --out layers
    """
    if kind == "single":
        _single(trials, seed, out, profile or "quick", as_json)
    elif profile is not None:
        raise click.UsageError("--profile is for --kind single: the other kinds draw their own plans.")
    else:
        _made_up(trials, seed, out, kind, as_json)


def _single(trials: int, seed: int, out: Path, profile: str, as_json: bool) -> None:
    from gyrocal.commands.blind import write_blind
    from gyrocal.trial.blind import BlindConfig

    with filling(out), progress("blind", quiet=as_json) as tell:
        summary = write_blind(BlindConfig(trials, seed, profile), out, tell).summary
    if as_json:
        emit_json(summary.to_json())
        return
    emit_table(_COLUMNS, [s.cells() for s in summary.shares])
    for d_prime, shares in summary.by_strength:
        click.echo("")
        emit_table((f"d' {d_prime:g}", *_COLUMNS[1:]), [s.cells() for s in shares])
    click.echo(f"\nOpened answers, seals and pictures: open {out / 'blind.html'}")


def _made_up(trials: int, seed: int, out: Path, kind: str, as_json: bool) -> None:
    from gyrocal.commands.blind import write_made_up
    from gyrocal.trial.blind import BlindConfig

    with filling(out), progress("blind", quiet=as_json) as tell:
        tally = write_made_up(BlindConfig(trials, seed, kind=kind), out, tell).tally
    if as_json:
        emit_json(tally.to_json())
        return
    emit_table(_COLUMNS, [s.cells() for s in tally.shares])
    click.echo("")
    emit_table(("Layers with a right name", *_COLUMNS[1:]), [s.cells() for s in tally.by_strength])
    click.echo(f"\nRemoved of the removable error on the second run: {tally.removed_text}.")
    click.echo(f"Opened answers and seals: open {out / 'blind.html'}")
