"""`whitted renderers`: what can run here."""

from __future__ import annotations

import click

from validation import records
from validation.commands.errors import errors
from validation.commands.help import Command


@click.command(
    "renderers",
    cls=Command,
    short_help="List the renderers, and what can run here.",
    examples=["whitted renderers", "whitted renderers --passes", "whitted renderers --missing"],
    statuses={0: "listed"},
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--missing", is_flag=True, help="Only those that cannot run here, a line each.")
@click.option("--passes", "by_pass", is_flag=True, help="Who delivers which pass, how, and at which precision.")
@click.pass_context
def list_renderers(ctx: click.Context, /, as_json: bool, missing: bool, by_pass: bool) -> None:
    """List the renderers: version, passes, and what to do for those that cannot run here."""
    from validation import catalogue
    from validation.terminal import print_passes, print_renderers

    with errors():
        entries, failures = catalogue.renderers()
    if missing:
        entries = [entry for entry in entries if not entry["available"]]
    if as_json:
        record = records.result("renderers", {"renderers": entries, "failures": failures})
        click.echo(records.text(record), nl=False)
    elif by_pass:
        print_passes(entries, failures)
    elif missing:
        for entry in entries:
            click.echo(f"not available: {entry['name']}: {entry['reason']}")
    else:
        print_renderers(entries, failures)
    ctx.exit(0)
