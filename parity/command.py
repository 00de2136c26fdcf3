"""What the commands of `parity` and `benchmarks` share: checks of options, consoles, progress bars."""

import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from iphyre_jax.checks import check_whole

REPORT_WIDTH = 130  # columns


def require_at_least(options: object, **least: int) -> None:
    """Check integer options.

    Raises:
        ValueError: an option is below its least value; the message names it.
    """
    for name, value in least.items():
        check_whole(f"--{name}", getattr(options, name), value)


def options_as_json(options: object) -> dict[str, Any]:
    """Options by name, as JSON takes them."""
    return {name: _plain(value) for name, value in vars(options).items()}


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return [_plain(inner) for inner in value]
    return str(value) if isinstance(value, Path) else value


def report_console() -> Console:
    """A console as wide as the terminal, or `REPORT_WIDTH` columns wide if the output goes elsewhere."""
    return Console(width=None if sys.stdout.isatty() else REPORT_WIDTH)


def progress_bar(console: Console) -> Progress:
    """A bar that shows what runs, how many pieces are done, and the time."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
    )
