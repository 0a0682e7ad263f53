"""``gyrocal demo``: the whole main job on the virtual bench, in a minute."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, json_option, progress
from gyrocal.cli.filling import filling


@click.command("demo")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New directory for everything.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the bench's noise."
)
@json_option
def command(out: Path, seed: int, as_json: bool) -> None:
    """Acquire on the virtual bench, fit, report, then drive a robot with the result.

    Needs nothing but this program. Since the gyro is simulated, its true error is known, and the fit is
    compared with it.

    Example: gyrocal demo --out demo
    """
    from gyrocal.commands.demo import DemoConfig, run_demo
    from gyrocal.units import DPS_TO_DPH, S_PER_H

    with filling(out), progress("demo", quiet=as_json) as tell:
        result = run_demo(DemoConfig(out, seed), tell)
    if as_json:
        emit_json(result.to_json())
        return
    truth = result.truth
    click.echo(
        f"Acquired {result.segments} segments, {result.bench_time_s / S_PER_H:.1f} h of bench time (seed {seed})."
    )
    click.echo(f"Calibrated. {result.report.verdict}")
    for remark in result.report.remarks:
        click.echo(f"- {remark}")
    click.echo(f"Driven. {result.drives}")
    click.echo(f"Pictures: {out / 'report' / 'report.html'} and {out / 'replay' / 'replay.html'}")
    click.echo(
        f"Proved: this gyro is simulated, so its true error is known. The fitted error is {truth.rms_dps * DPS_TO_DPH:.2f} "
        f"deg/h rms off it, and its own stated uncertainty says {truth.expected_rms_dps * DPS_TO_DPH:.2f}."
    )
