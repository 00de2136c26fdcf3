"""Tables on a terminal and in files, with all of their columns at any width."""

from __future__ import annotations

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

_WIDEST = 10_000  # characters


def print_table(console: Console, table: Table) -> None:
    """Print a table. On a terminal its cells fold; a file gets whole lines, however long.

    Rich would shorten cells and leave out columns that do not fit.
    """
    for column in table.columns:
        column.no_wrap, column.overflow = False, "fold"
    needed = Measurement.get(console, console.options.update(max_width=_WIDEST), table)
    width = console.width
    console.width = max(width, needed.minimum) if console.is_terminal else needed.maximum
    try:
        console.print(table)
    finally:
        console.width = width


def say(console: Console, text: str) -> None:
    """Print text as it is: no markup, no colours, no line breaks of our own."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)
