"""Rows of a table that take long: computed once, kept as JSON with their origin, and not computed again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from iphyre_jax.checks import show
from iphyre_jax.files import read_versioned, replace_json
from iphyre_jax.provenance import differences, provenance

SCHEMA: Final = "iphyre_jax/analysis-row"
VERSION: Final = 1

Row = Mapping[str, Any]


def kept_row(folder: Path, name: str, settings: Mapping[str, Any], compute: Callable[[], Row]) -> Row:
    """Return a row from its file, or compute it and write the file; it is whole at any moment.

    Args:
        folder: of the rows; made if it is missing.
        name: of the row, that of its file.
        settings: JSON values that decide the row.
        compute: gives the row as JSON values.

    Raises:
        ValueError: the file holds a row of other settings, or something else; one line.
        OSError: the folder or the file cannot be read or written.
    """
    file = folder / f"{name}.json"
    if not file.is_file():
        content = {"schema": SCHEMA, "version": VERSION, "settings": dict(settings), "row": dict(compute())}
        folder.mkdir(parents=True, exist_ok=True)
        replace_json(file, {**content, "origin": provenance()})
    return read_row(file, settings)


def read_row(file: Path, settings: Mapping[str, Any] | None = None) -> Row:
    """Return the row in a file.

    Args:
        file: as `kept_row` writes it.
        settings: those that are expected; None for any.

    Raises:
        ValueError: it holds a row of other settings, or something else; one line.
        OSError: it cannot be read.
    """
    content = read_versioned(file, SCHEMA, (VERSION,))
    row = content.get("row")
    if not isinstance(row, dict):
        raise ValueError(f"{file}: row: expected an object, got {show(row)}")
    found = content.get("settings")
    if settings is not None and found != dict(settings):
        raise ValueError(f"{file}: settings: expected others: {differences(found, settings)}; remove the file")
    return row


def rows_there(folder: Path, settings: Mapping[str, Mapping[str, Any]]) -> dict[str, Row]:
    """Return those of some rows that are in a folder; settings: of each by name. Errors as those of `read_row`."""
    files = {name: folder / f"{name}.json" for name in settings}
    return {name: read_row(file, settings[name]) for name, file in files.items() if file.is_file()}


def read_rows(folder: Path) -> dict[str, Row]:
    """Return all rows of a folder by name, none if it is missing; errors as those of `read_row`."""
    return {file.stem: read_row(file) for file in sorted(folder.glob("*.json"))}
