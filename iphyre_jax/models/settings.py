"""Settings of a model from files; the settings themselves stand beside each kind of model."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar, cast

from iphyre_jax.checks import check_option, show


class Settings(Protocol):
    """Settings of a model: a frozen dataclass."""

    @property
    def name(self) -> str:
        """Of the run, and of its folder."""

    def check(self) -> None:
        """Raise ValueError, one line naming the setting and what was expected, if they cannot work."""

    def to_json(self) -> dict[str, Any]:
        """The settings as a JSON object."""


S = TypeVar("S", bound=Settings)


def row_of(rows: Mapping[str, S], name: str) -> S:
    """The settings of a row of a report; ValueError, one line, if there is no such row."""
    return rows[check_option("row", name, tuple(rows))]


def wanted_rows(rows: Mapping[str, S], only: Sequence[str]) -> list[str]:
    """The names of the rows asked for, by default all; ValueError, one line, if there is no such row."""
    return [check_option("only", name, tuple(rows)) for name in only] or list(rows)


def settings_of(kind: type[S], content: object, source: str) -> S:
    """The settings that `to_json` wrote.

    Args:
        kind: class of the settings.
        content: JSON value.
        source: where it is from, for errors.

    Raises:
        ValueError: one line that begins with `source`; a setting is missing, unknown or wrong.
    """
    names = {field.name for field in dataclasses.fields(cast(Any, kind))}
    needed = names - set(getattr(kind, "LATER", ()))
    if not isinstance(content, dict) or not needed <= set(content) <= names:
        raise ValueError(f"{source}: settings: expected {', '.join(sorted(names))}, got {show(content)}")
    config = kind(**content)
    try:
        config.check()
    except ValueError as error:
        raise ValueError(f"{source}: settings: {error}") from None
    return config
