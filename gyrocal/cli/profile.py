"""``gyrocal profile``: the profiles that ship, and a commented one to begin from."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_table, json_option, overwrite_option


@click.command("profile")
@click.option("--template", is_flag=True, help="Write a profile with every key, its default and its range.")
@click.option("--output", "-o", type=click.Path(path_type=Path), help="File to write; without it, stdout.")
@overwrite_option
@json_option
def command(template: bool, output: Path | None, overwrite: bool, as_json: bool) -> None:
    """List the profiles that ship; with --template, write a commented one of your own.

    What `acquire` finds wrong in a profile it lists all at once.

    Example: gyrocal profile --template -o mine.toml
    """
    from gyrocal.bench.profile import load_profile, shipped_profiles
    from gyrocal.bench.template import template as text_of_template
    from gyrocal.records.files import check_output_file, write_atomically

    if not template:
        if output is not None:
            raise click.UsageError("-o says where the template goes; ask for it with --template.")
        titles = {name: load_profile(path).title for name, path in shipped_profiles().items()}
        if as_json:
            emit_json(titles)
        else:
            emit_table(("profile", "what it is for"), list(titles.items()))
        return
    if output is None:
        click.echo(text_of_template(), nl=False)
        return
    check_output_file(output, overwrite=overwrite)
    write_atomically(output, text_of_template())
    click.echo(f"{output}: edit it, then check it with: gyrocal acquire {output} --dry-run")
