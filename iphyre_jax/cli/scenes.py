"""`iphyre-jax scene`: what there is to do with scene files. Needs the extra `train`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from iphyre_jax.scenes import Limits, read_scene, scene_json_schema
from iphyre_jax.scenes.geometry import scene_warnings


@dataclass(frozen=True)
class Check:
    """Read scene files and say what they hold, or what is wrong with them. Ends with 2 if a file is wrong."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """The files."""
    max_objects: int | None = None
    """Objects that a scene may have, 12 to 64; by default what the file states, or else 12."""
    max_blocks: int | None = None
    """Eliminable blocks that a scene may have, 6 to 64; by default what the file states, or else 6."""


@dataclass(frozen=True)
class Schema:
    """Print the JSON Schema of scene files."""


@dataclass(frozen=True)
class SceneCommand:
    """Check scene files of your own."""

    action: Annotated[
        Annotated[Check, tyro.conf.subcommand("check")] | Annotated[Schema, tyro.conf.subcommand("schema")],
        tyro.conf.arg(name=""),
    ]


def run(command: SceneCommand, console: Console) -> None:
    """Do what a scene command asks.

    Raises:
        ValueError: a file is wrong; one line for each wrong field.
        OSError: a file cannot be read; one line.
    """
    if isinstance(command.action, Schema):
        print(json.dumps(scene_json_schema(), indent=1))
        return
    if not command.action.files:
        raise ValueError("files: expected at least one scene file")
    limits = _limits(command.action)
    wrong = []
    for path in command.action.files:
        try:
            _describe(path, limits, console)
        except (ValueError, OSError) as error:
            wrong.append(str(error))
    if wrong:
        raise ValueError("\n".join(wrong))


def _limits(check: Check) -> Limits | None:
    """Return the limits that the options set; None if they set none."""
    options = {"objects": check.max_objects, "blocks": check.max_blocks}
    given = {name: most for name, most in options.items() if most is not None}
    return Limits(**given) if given else None


def _describe(path: Path, limits: Limits | None, console: Console) -> None:
    """Print what a file holds, and what is unusual about it."""
    scene = read_scene(path, limits)
    moving = int(scene.dynamic[: scene.n_blocks].sum())
    parts = [
        f"{scene.n_blocks} blocks ({len(scene.eliminable_blocks)} eliminable, {moving} moving)",
        f"{scene.n_balls} balls",
        f"{len(scene.joints)} joints",
        f"{len(scene.springs)} springs",
    ]
    lines = [f"{path}: valid, {scene.name}: {', '.join(parts)}", *(f"{path}: {line}" for line in scene_warnings(scene))]
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
