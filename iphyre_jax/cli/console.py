"""What the parts of the command line share: plain printing, and options with their names in the help."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TextIO

import tyro
from rich.console import Console

from iphyre_jax.checks import show


class CommandConsole(Console):
    """A console that tells of a reader who has gone, as `| head` does; rich's own would end the process with 1."""

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError; `cli.main` gives the exit code."""
        raise BrokenPipeError


def refuse_unread(command: Any, read: Collection[str], why: str) -> None:  # noqa: ANN401 - any command
    """Refuse options that would be ignored.

    Args:
        command: the dataclass of a command.
        read: names of the options that are read.
        why: when the others are not, as in "with --describe".

    Raises:
        ValueError: another option is not its default; one line.
    """
    for entry in fields(command):
        given = getattr(command, entry.name)
        if entry.name not in read and given != entry.default:
            shown = str(given) if isinstance(given, Path) else given
            raise ValueError(f"{entry.name}: expected none {why}, got {show(shown)}")


def option(metavar: str, text: str, default: str | None = None, *, aliases: tuple[str, ...] = ()) -> object:
    """Describe an option: the name of its value, its help text, and how the help shows the default."""
    hint = None if default is None else f"(default: {default})" if default else ""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=hint, aliases=aliases or None)


# What several commands take.
Plan = Annotated[
    tuple[str, ...],
    option(
        "SECONDS ...",
        'When to remove each eliminable block, in the order of "iphyre-jax games": seconds, separated by spaces. '
        '"never" or "-" keeps a block, and so does 0, by the official rules. Blocks without a time stay.',
        "remove nothing",
    ),
]


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print warnings, such as those about damaged files, like the errors of a command."""

    def show_warning(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        del filename, lineno, file, line
        print(f"iphyre-jax: {category.__name__}: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        yield
