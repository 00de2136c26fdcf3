"""`iphyre-jax scene`: check scene files. Needs the extra `train`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from iphyre_jax.cli.console import option
from iphyre_jax.scenes import Limits, read_scene, scene_json_schema
from iphyre_jax.scenes.geometry import scene_warnings
from iphyre_jax.scenes.library import ALL_GAMES
from iphyre_jax.train.reports.printing import say


@dataclass(frozen=True)
class Check:
    """Read scene files and print their contents or their errors. The exit code is 2 if a file is wrong."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], option("FILE ...", "The scene files.", "")]
    max_objects: Annotated[
        int | None, option("COUNT", "Number of objects to allow, 12 to 64.", "as the file states, else 12")
    ] = None
    max_blocks: Annotated[
        int | None, option("COUNT", "Number of eliminable blocks to allow, 6 to 64.", "as the file states, else 6")
    ] = None


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
    """Run a scene command.

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
    errors = []
    for path in command.action.files:
        try:
            _print_contents(path, limits, console)
        except (ValueError, OSError) as error:
            errors.append(str(error))
    if errors:
        raise ValueError("\n".join(errors))


def _limits(check: Check) -> Limits | None:
    """Return the limits of the options; None if none is given."""
    options = {"objects": check.max_objects, "blocks": check.max_blocks}
    given = {name: most for name, most in options.items() if most is not None}
    return Limits(**given) if given else None


def _print_contents(path: Path, limits: Limits | None, console: Console) -> None:
    """Print the contents of a scene file, and warnings."""
    scene = read_scene(path, limits)
    moving = int(scene.dynamic[: scene.n_blocks].sum())
    counts = [
        f"{scene.n_blocks} blocks ({len(scene.eliminable_blocks)} eliminable, {moving} moving)",
        f"{scene.n_balls} balls",
        f"{len(scene.joints)} joints",
        f"{len(scene.springs)} springs",
    ]
    named = [f"name: {scene.name} is a game of the package; no run trains on or evaluates another scene of this name"]
    warnings = [*(named if scene.name in ALL_GAMES else []), *scene_warnings(scene)]
    for line in (f"valid, {scene.name}: {', '.join(counts)}", *warnings):
        say(console, f"{path}: {line}")
