"""Tables on a terminal and in files, with all of their columns at any width."""

from __future__ import annotations

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

_WIDEST = 10_000  # characters


def print_table(console: Console, table: Table) -> None:
    """Print a table. On a terminal its cells fold at words; a file gets whole lines, however long.

    Rich would shorten cells and leave out columns that do not fit.
    """
    for column in table.columns:
        words = [word for cell in (column.header, *column.cells) for word in str(cell).split()]
        column.min_width = max(map(len, words), default=0)
    room = 2 * len(table.columns)  # around cells, which rich leaves out of the minimum
    needed = Measurement.get(console, console.options.update(max_width=_WIDEST), table)
    width = console.width
    console.width = max(width, needed.minimum + room) if console.is_terminal else needed.maximum
    try:
        console.print(table)
    finally:
        console.width = width
