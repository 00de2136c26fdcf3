"""Small cases in which the engines once differed, kept as files so that a test plays them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from iphyre_jax.files import replace_text
from iphyre_jax.scenes.codec import scene_from_dict, scene_to_dict


@dataclass(frozen=True)
class Case:
    """One plan of one scene.

    Attributes:
        scene: the scene.
        eliminate_at: the plan.
        fps: physics steps a second.
        resets: number of the reset.
        why: what differed, in one line.
    """

    scene: Scene
    eliminate_at: tuple[int, ...]
    fps: int
    resets: int
    why: str

    @property
    def plan(self) -> NDArray[np.int32]:
        """The plan as `iphyre_jax.simulate` takes a row of it, (S,)."""
        return np.array(self.eliminate_at, np.int32)


def write_case(folder: Path, case: Case) -> Path:
    """Write a case as JSON, named after its scene; create the folder if it is missing.

    Returns:
        The file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{case.scene.name}.json"
    fields = {name: getattr(case, name) for name in ("why", "fps", "resets", "eliminate_at")}
    lines = [f' "{name}": {json.dumps(value)}' for name, value in fields.items()]
    lines.append(f' "scene": {json.dumps(scene_to_dict(case.scene))}')
    replace_text(path, "{\n" + ",\n".join(lines) + "\n}\n")
    return path


def read_case(path: Path) -> Case:
    """Read a case that `write_case` has written.

    Raises:
        ValueError: the scene is not valid; one line for each wrong field.
        OSError: the file cannot be read.
    """
    data = json.loads(path.read_text(encoding="utf-8"))
    scene = scene_from_dict(data["scene"], str(path))
    return Case(scene, tuple(data["eliminate_at"]), data["fps"], data["resets"], data["why"])
