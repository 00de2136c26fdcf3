"""Settings from JSON."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from iphyre_jax.checks import show
from iphyre_jax.train.settings import old_names
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import TrainConfig


def config_from_json(values: object, source: str | Path, *, old: bool = False) -> TrainConfig:
    """The settings that `TrainConfig.to_json` wrote.

    Args:
        values: parsed JSON.
        source: where they come from, for the error.
        old: they have the names of `old_names`.

    Raises:
        ValueError: one line naming `source` and the field.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{source}: expected an object of settings, got {type(values).__name__}")
    if old:
        values = old_names.settings(values)
    agent = values.get("agent", TrainConfig.agent)
    if agent not in list(AGENTS):
        raise ValueError(f"{source}: agent: expected one of {', '.join(AGENTS)}, got {show(agent)}")
    learner = _fields(AGENTS[agent].settings(), values.get("learner", {}), source)
    plain = {name: value for name, value in values.items() if name != "learner"}
    config: TrainConfig = _fields(TrainConfig(learner=learner), plain, source)
    try:
        config.check()
    except (ValueError, OSError) as error:  # of a scene file among the games
        raise ValueError(f"{source}: {error}") from None
    return config


def _fields(default: Any, values: object, source: str | Path) -> Any:  # noqa: ANN401 - any dataclass, and the same back
    """A dataclass with fields read from JSON, each of the type of its default."""
    if not isinstance(values, dict):
        raise ValueError(f"{source}: learner: expected an object of settings, got {type(values).__name__}")
    known = {entry.name: getattr(default, entry.name) for entry in dataclasses.fields(default)}
    settings: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"{source}: unknown setting {show(name)}")
        settings[name] = tuple(value) if isinstance(value, list) else value
        if not _same_type(settings[name], known[name]):
            raise ValueError(f"{source}: {name}: expected a value like {known[name]!r}, got {show(value)}")
    return dataclasses.replace(default, **settings)


def _same_type(value: object, default: object) -> bool:
    """Whether a value read from JSON fits a field with this default."""
    if isinstance(value, int) and value.bit_length() > 63:
        return False
    if isinstance(default, tuple):
        item_type = type(default[0]) if default else str
        return isinstance(value, tuple) and all(type(item) is item_type for item in value)
    if isinstance(default, float):
        return type(value) in (int, float)
    return type(value) is type(default)
