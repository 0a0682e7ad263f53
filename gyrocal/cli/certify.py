"""``gyrocal certify``: runs of one unit to one certificate."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_list, emit_table, json_option, progress, scale_number
from gyrocal.errors import OutOfLimitsError


@click.command("certify")
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="New directory for the certificate."
)
@click.option(
    "--limits",
    type=click.Path(path_type=Path),
    help="TOML: FIGURE = { most = NUMBER } (its size; or least), { low = NUMBER, high = NUMBER } (with its sign; or one of "
    'them), with state = "after" for that after compensation; pass or fail.',
)
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Nominal scale of tables in gyro_counts, sign included.",
)
@click.option("--pdf", is_flag=True, help="Also write certificate.pdf (needs the extra gyrocal[pdf]).")
@json_option
def command(
    runs: tuple[Path, ...],
    out: Path,
    limits: Path | None,
    counts_per_dps: float | None,
    pdf: bool,
    as_json: bool,
) -> None:
    """Write the certificate of one unit from RUNS, in the order in which they were made, or the directory that holds them.

    Identity, verdict, figures before and after compensation with 95 % intervals, repeatability over the runs, pictures,
    what was not tested, limits of the data, checksums. With --limits a figure passes when all of its interval is
    inside, fails when all of it is outside, and is not decided in between; a failed figure gives its own exit code. Runs at
    rest (static_allan, thermal_ramp) add to the noise.

    Example: gyrocal certify run1 run2 run3 --out certificate
    """
    from gyrocal.commands.certify import CertifyConfig, write_certificate
    from gyrocal.report.certificate import certificate_sentence, figure_rows, to_json

    with progress("certify", quiet=as_json) as tell:
        dossier = write_certificate(CertifyConfig(runs, out, limits, counts_per_dps, pdf), tell)
    if as_json:
        emit_json(to_json(dossier))
    else:
        click.echo(certificate_sentence(dossier)[0])
        click.echo("")
        emit_table(*figure_rows(dossier))
        click.echo("\nNot tested:")
        emit_list(dossier.not_tested)
        if dossier.quality:
            click.echo("\nThe data:")
            emit_list(dossier.quality)
        click.echo(f"\nCertificate: open {out / 'certificate.html'}")
    if dossier.failed:
        names = ", ".join(f"{row.known.title} ({row.limit})" for row in dossier.failed)
        raise OutOfLimitsError(
            f"{out}: the unit is beyond its limits: {names}. The certificate says by how much."
        )
