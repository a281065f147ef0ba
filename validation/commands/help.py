"""What `--help` looks like: examples, options in groups with their defaults, and exit statuses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click

#: Options by the parameter they become, in groups; all others are about what the command does.
GROUPS = {
    "Drawing": ("size", "sample", "shadow_epsilon", "max_reflections", "threads", "no_limits"),
    "Results": (
        "output",
        "plot",
        "report",
        "open_report",
        "small",
        "include",
        "write",
        "json_file",
        "as_json",
        "junit",
        "markdown",
    ),
    "General": ("quiet", "verbose", "version", "help"),
}

#: What the statuses mean that every command may end with.
ALWAYS = {
    2: "something is wrong with the command, a scene or a file",
    130: "interrupted (Ctrl-C)",
    141: "who reads the output has closed the pipe",
    143: "terminated (SIGTERM)",
}


class Command(click.Command):
    """A command with examples, which a test runs, and exit statuses."""

    def __init__(
        self, *arguments: Any, examples: Sequence[str] = (), statuses: Mapping[int, str] | None = None, **more: Any
    ) -> None:
        """`examples`: lines for a shell, one after the other; `statuses`: besides those of every command."""
        super().__init__(*arguments, **more)
        self.examples = tuple(examples)
        self.statuses = dict(sorted({**ALWAYS, **(statuses or {})}.items()))

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """What it does, and examples."""
        super().format_help_text(ctx, formatter)
        write_examples(formatter, self.examples)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options, group by group."""
        rows: dict[str, list[tuple[str, str]]] = {title: [] for title in ("Options", *GROUPS)}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if row:
                # Click has a name of its own for --help.
                name = "help" if "--help" in parameter.opts else parameter.name
                title = next((title for title, names in GROUPS.items() if name in names), "Options")
                rows[title].append(row)
        for title, group in rows.items():
            if group:
                with formatter.section(title):
                    formatter.write_dl(group)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The exit statuses."""
        del ctx
        write_statuses(formatter, self.statuses)


def write_examples(formatter: click.HelpFormatter, examples: Sequence[str]) -> None:
    """Lines as they are typed: not wrapped, so that they can be copied."""
    if examples:
        with formatter.section("Examples"):
            for line in examples:
                formatter.write(f"{'':>{formatter.current_indent}}$ {line}\n")


def write_statuses(formatter: click.HelpFormatter, statuses: Mapping[int, str]) -> None:
    """What the exit statuses mean."""
    with formatter.section("Exit status"):
        formatter.write_dl([(str(status), text) for status, text in statuses.items()])
