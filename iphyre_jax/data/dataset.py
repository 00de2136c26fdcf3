"""A data set of plays, in memory and as two files: NAME.npz, arrays without pickles, and NAME.json, the manifest.

{"schema": "iphyre_jax/dataset", "version": 1,
 "distribution": "official", "form": "fresh", "fps": 60, "rule": "simulate", "frames": 900, "resets": 1,
 "dtype": "float64", "seed": 0, "split": "train",
 "scenes": [{"scene": "support", "sha256": ..., "iterations": 122, ...}, ...],
 "arrays": {"game": {"dtype": "int32", "shape": [4000], "sha256": ...}, ...},
 "npz": {"bytes": ..., "sha256": ...}, "sha256": ...}          of the whole manifest without this field

A reader refuses a changed byte of either file.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_RESETS, check_rows, one_line, show
from iphyre_jax.data.arrays import ARRAYS, MAX_STEPS, check_arrays, frames_of
from iphyre_jax.data.targets import check_path, check_target
from iphyre_jax.files import check_exist, pack_npz, parse_json, read_npz, replace_bytes
from iphyre_jax.memory import check_memory
from iphyre_jax.plans import Rule
from iphyre_jax.scenes import Scene, load_scene, scene_from_dict, scene_to_dict
from iphyre_jax.scenes.library import ALL_GAMES, is_game

SCHEMA: Final = "iphyre_jax/dataset"
VERSION: Final = 1
MAX_MANIFEST: Final = 200_000_000  # bytes; ten thousand scenes take some 10 MB
EACH_RESET: Final = "draw + 2"  # the reset of each play of the form "exact"
HEADERS: Final = 100_000  # bytes of NAME.npz beside its arrays
REQUIRED: Final = ("schema", "version", "distribution", "form", "fps", "rule", "frames", "resets", "dtype", "seed")


@dataclass(frozen=True, eq=False)
class Dataset:
    """N plays.

    Attributes:
        scenes: every scene of the manifest, in its order.
        game: (N,) int32, index into `scenes`.
        times: (N, S) float32, s; NaN is never. Column i is the i-th eliminable block; S is 6, or more if a scene's
            limits are larger. An entry may lie after the end of its play. float32 rounds 0.1 s: to compute steps, take
            `drawn_times`.
        steps: (N, S) int16, the step before which each block goes, -1 for never: what was played.
        success: (N,) bool.
        end_step: (N,) int16, physics steps made, the solving one included.
        removals: (N,) int8, blocks removed before the end.
        draw: (N,) int32, number of the draw among those of its scene, from 0.
        poses: (N, 150, M, 3) float32 or float64, or None: x, y (px) and angle (rad) of the objects that move, in list
            order, after 0, fps/10, 2 fps/10, ... steps; NaN after an object's removal and beyond a scene's movers. The
            last pose repeats after the end.
        manifest: the fields that the module shows; `save_dataset` adds the sums.
    """

    scenes: tuple[Scene, ...]
    game: npt.NDArray[np.int32]
    times: npt.NDArray[np.float32]
    steps: npt.NDArray[np.int16]
    success: npt.NDArray[np.bool_]
    end_step: npt.NDArray[np.int16]
    removals: npt.NDArray[np.int8]
    draw: npt.NDArray[np.int32]
    poses: npt.NDArray[np.floating[Any]] | None
    manifest: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.game)

    @property
    def fps(self) -> int:
        """Physics steps a second."""
        return int(self.manifest["fps"])

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by name, `poses` only if there are any."""
        named = {field.name: getattr(self, field.name) for field in fields(self) if field.name in ARRAYS}
        return {name: array for name, array in named.items() if array is not None}

    def select(self, rows: npt.ArrayLike) -> Dataset:
        """Return some plays; rows: indices or a mask, (N,). ValueError in one line for others.

        The scenes and the manifest, with its counts of plays, stay those of the whole set.
        """
        index = check_rows(rows, len(self))
        return replace(self, **{name: array[index] for name, array in self.arrays().items()})

    def of_game(self, name: str) -> Dataset:
        """Return the plays of the scene of this name, or of all scenes that have it.

        Raises:
            ValueError: there is no such scene; one line.
        """
        named = [number for number, scene in enumerate(self.scenes) if scene.name == name]
        if not named:
            raise ValueError(f"name: expected the name of a scene of the data set, got {show(name)}")
        return self.select(np.isin(self.game, named))


@lru_cache(4096)
def scene_sum(scene: Scene) -> str:
    """Return the SHA-256 of a scene's contents, in hexadecimal digits."""
    return hashlib.sha256(json.dumps(scene_to_dict(scene), sort_keys=True).encode()).hexdigest()


def scene_entry(scene: Scene) -> dict[str, Any]:
    """Return the fields `scene` and `sha256` of a manifest: a game's name, or the contents of a scene file."""
    return {"scene": scene.name if is_game(scene) else scene_to_dict(scene), "sha256": scene_sum(scene)}


def save_dataset(dataset: Dataset, path: str | os.PathLike[str]) -> None:
    """Write a data set as NAME.npz and NAME.json. Each file is whole at any moment; equal data sets give equal bytes.

    Args:
        dataset: what to write.
        path: of NAME.npz or NAME.json.

    Raises:
        ValueError: the path has another ending, NAME.json is there and is something else, a field is wrong, or an
            array has another type, shape or other numbers; one line.
        OSError: a file cannot be written.
    """
    npz, manifest = check_target(path, SCHEMA, ARRAYS)
    arrays = dataset.arrays()
    _check_fields({"arrays": {}, "npz": {"bytes": 0}, **dataset.manifest}, "dataset: manifest")
    check_arrays(arrays, dataset.scenes, dataset.manifest, "dataset")
    content = pack_npz(arrays)
    described = {
        **{key: value for key, value in dataset.manifest.items() if key not in ("arrays", "npz", "sha256")},
        "arrays": {name: _describe(array) for name, array in arrays.items()},
        "npz": {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()},
    }
    replace_bytes(npz, content)
    replace_bytes(manifest, _text(_with_sum(described)))


def load_dataset(path: str | os.PathLike[str]) -> Dataset:
    """Read a data set.

    Args:
        path: of NAME.npz or NAME.json; both must be there.

    Raises:
        OSError: a file cannot be read.
        ValueError: a byte of either file was changed, a field is wrong, or memory does not suffice; one line.
    """
    npz, manifest_file = check_path(path)
    check_exist(npz, manifest_file)
    manifest = _read_manifest(manifest_file)
    with npz.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size != manifest["npz"]["bytes"]:
            raise ValueError(f"{one_line(str(npz))}: expected {manifest['npz']['bytes']} bytes, got {size}")
        check_memory("path", 2 * size + _unpacked(manifest), "read it on a machine with more memory")
        if hashlib.file_digest(file, "sha256").hexdigest() != manifest["npz"].get("sha256"):
            raise ValueError(f"{one_line(str(npz))}: expected the bytes of its manifest, but they were changed")
    arrays = read_npz(npz, max(size, _unpacked(manifest)) + HEADERS)
    scenes = tuple(_read_scene(entry, f"{manifest_file}: scenes[{k}]") for k, entry in enumerate(manifest["scenes"]))
    check_arrays(arrays, scenes, manifest, one_line(str(npz)))
    return Dataset(scenes, **{name: arrays.get(name) for name in ARRAYS}, manifest=manifest)  # type: ignore[arg-type]


def _describe(array: npt.NDArray[Any]) -> dict[str, Any]:
    content = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
    return {"dtype": str(array.dtype), "shape": list(array.shape), "sha256": content}


def _text(content: Mapping[str, Any]) -> bytes:
    """Return a manifest as text: a line for each field, and for each scene."""
    scenes = ",\n  ".join(map(json.dumps, content["scenes"]))
    written = {key: f"[\n  {scenes}\n ]" if key == "scenes" else json.dumps(value) for key, value in content.items()}
    return ("{\n" + ",\n".join(f" {json.dumps(key)}: {value}" for key, value in written.items()) + "\n}\n").encode()


def _with_sum(described: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with the sum over all of its other fields."""
    return {**described, "sha256": hashlib.sha256(_text(described)).hexdigest()}


def _read_manifest(file: Path) -> dict[str, Any]:
    """Return a manifest whose every byte is what `save_dataset` wrote."""
    name = one_line(str(file))
    with file.open("rb") as opened:
        content = opened.read(MAX_MANIFEST + 1)
    manifest = parse_json(content, str(file), MAX_MANIFEST)
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise ValueError(f"{name}: schema: expected {SCHEMA!r}, the manifest of a data set")
    if manifest.get("version") != VERSION:
        raise ValueError(f"{name}: version: expected {VERSION}, got {show(manifest.get('version'))}")
    _check_fields(manifest, name)
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    if _text(_with_sum(rest)) != content:
        raise ValueError(f"{name}: expected the bytes that its sum tells of, but they were changed")
    return manifest


def _check_fields(manifest: Mapping[str, Any], source: str) -> None:
    """Refuse a manifest with a wrong field, or with fields that contradict each other; one line."""
    for field, is_right, what in _FIELDS:
        if field not in manifest or not is_right(manifest[field]):
            raise ValueError(f"{source}: {field}: expected {what}, got {show(manifest.get(field))}")
    if (manifest["form"] == "exact") != (manifest["resets"] == EACH_RESET):
        what = f"{EACH_RESET} for the form exact, and a number for fresh"
        raise ValueError(f"{source}: resets: expected {what}, got {show(manifest['resets'])}")
    if manifest["frames"] != (frames := frames_of(manifest["fps"], manifest["rule"])):
        raise ValueError(f"{source}: frames: expected {frames}, got {show(manifest['frames'])}")


def _is_array_description(value: object) -> bool:
    is_object = isinstance(value, dict) and isinstance(value.get("shape"), list)
    return is_object and all(type(side) is int and 0 <= side < 2**40 for side in value["shape"])  # type: ignore[index]


def _is_reset(value: object) -> bool:
    return (type(value) is int and 0 < value <= MAX_RESETS) or value == EACH_RESET


def _is_entry(value: object) -> bool:
    return isinstance(value, dict) and isinstance(value.get("scene"), str | dict) and "sha256" in value


_FIELDS: Final[tuple[tuple[str, Callable[[Any], bool], str], ...]] = (
    ("form", lambda value: value in ("fresh", "exact"), "fresh or exact"),
    ("rule", lambda value: value in get_args(Rule), "simulate or in_advance"),
    ("resets", lambda value: _is_reset(value), "the number of a reset from 1 on, or draw + 2"),
    ("fps", lambda value: type(value) is int and 0 < value <= MAX_STEPS, "a positive whole number"),
    ("scenes", lambda value: isinstance(value, list) and all(map(_is_entry, value)), "a list of scenes"),
    (
        "arrays",
        lambda value: (
            isinstance(value, dict) and set(value) <= set(ARRAYS) and all(map(_is_array_description, value.values()))
        ),
        "a description of each array",
    ),
    ("npz", lambda value: isinstance(value, dict) and type(value.get("bytes")) is int, "size and sum of the arrays"),
    *((key, lambda _: True, "this field") for key in REQUIRED),
)


def _unpacked(manifest: Mapping[str, Any]) -> int:
    """Return the bytes of all arrays, from their descriptions."""
    described = manifest["arrays"].items()
    return int(sum(math.prod(array["shape"]) * np.dtype(ARRAYS[name][-1]).itemsize for name, array in described))


def _read_scene(entry: Mapping[str, Any], source: str) -> Scene:
    """Return the scene of an entry; a game of the package must still be what it was."""
    given = entry["scene"]
    own = isinstance(given, str) and given in ALL_GAMES
    scene = load_scene(given) if own else scene_from_dict(given, source)
    if (found := scene_sum(scene)) != entry["sha256"]:
        raise ValueError(f"{source}: sha256: expected {entry['sha256']}, but {scene.name} has {found}")
    return scene
