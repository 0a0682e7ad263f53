"""``gyrocal decode``: raw bytes of a capture to samples."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from gyrocal.cli.console import emit_json, json_option, overwrite_option


@click.command()
@click.argument("capture", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "--out",
    "output",
    required=True,
    type=click.Path(path_type=Path),
    help="CSV file to write.",
)
@overwrite_option
@json_option
def command(capture: Path, output: Path, overwrite: bool, as_json: bool) -> None:
    """Decode a raw CAPTURE (acquire --raw) through the codec that recorded it.

    \b
    Example:
      gyrocal decode run/raw/gyro-1.raw -o samples.csv
    """
    from gyrocal.bench.capture import decode_capture
    from gyrocal.records.files import check_output_file

    run = capture.resolve().parent.parent
    inputs = [capture, *([run] if (run / "run.json").exists() else [])]
    check_output_file(output, overwrite=overwrite, inputs=inputs)
    decoded = decode_capture(capture, output)
    if as_json:
        emit_json(
            {
                "device": decoded.device,
                "duration_s": decoded.duration_s,
                "cut_off": decoded.cut_off,
                "health": asdict(decoded.health),
            }
        )
        return
    h = decoded.health
    click.echo(
        f"{decoded.device}: {h.frames_good} frames in {decoded.duration_s:.1f} s, {h.frames_bad} damaged, "
        f"{h.bytes_skipped} of {h.bytes_in} bytes skipped, {h.sequence_gaps} gaps in the counter, "
        f"{h.status_bad} that the device calls bad. Written to {output}."
    )
    if decoded.cut_off:
        click.echo(
            f"{capture} ends in the middle of a line: by a crash, or a copy that was not finished. What came after is not in it."
        )
