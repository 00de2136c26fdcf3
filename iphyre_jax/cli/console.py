"""What the parts of the command line share: plain printing, and options with their names in the help."""

from __future__ import annotations

import tyro
from rich.console import Console


class CommandConsole(Console):
    """A console that tells of a reader who has gone, as `| head` does; rich's own would end the process with 1."""

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError; `cli.main` gives the exit code."""
        raise BrokenPipeError


def say(console: Console, text: str) -> None:
    """Print text as it is: no markup, no colours, no line breaks of our own."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def option(metavar: str, text: str, default: str | None = None, *, aliases: tuple[str, ...] = ()) -> object:
    """Describe an option: the name of its value, its help text, and how the help shows the default."""
    hint = None if default is None else f"(default: {default})" if default else ""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=hint, aliases=aliases or None)
