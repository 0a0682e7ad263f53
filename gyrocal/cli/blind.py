"""``gyrocal blind``: hidden physics, sealed answers."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_table, json_option, progress


@click.command("blind")
@click.option("--trials", type=click.IntRange(min=1), default=20, show_default=True, help="Number of runs.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of everything that is drawn."
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New directory for the results.")
@click.option(
    "--profile",
    default="quick",
    show_default=True,
    help="Your profile (.toml), or the name of a shipped one.",
)
@json_option
def command(trials: int, seed: int, out: Path, profile: str, as_json: bool) -> None:
    """Hide a random effect, several, or none in virtual runs of your profile, and let `diagnose` find them.

    Each answer is sealed by a hash before the diagnosis and opened after. Writes blind.json, blind.html with
    pictures, and commitments.txt. The virtual bench shares its formulas with the finder, so this proves less
    than recordings made by other code do.

    Example: gyrocal blind --trials 20 --seed 1 --out blind
    """
    from gyrocal.report.diagnosis_blind import write_blind
    from gyrocal.trial.blind import BlindConfig

    config = BlindConfig(trials, seed, profile)
    with progress("blind", quiet=as_json) as tell:
        result = write_blind(config, out, tell)
    summary = result.summary
    if as_json:
        emit_json(summary.to_json())
        return
    emit_table(("", "Trials", "Share, 95 % interval"), [s.cells() for s in summary.shares])
    for d_prime, shares in summary.by_strength:
        click.echo("")
        emit_table((f"d' {d_prime:g}", "Trials", "Share, 95 % interval"), [s.cells() for s in shares])
    click.echo(f"\nOpened answers, seals and pictures: open {out / 'blind.html'}")
