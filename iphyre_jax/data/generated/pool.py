"""Generated scenes with their grades, in memory and as two files: NAME.npz, arrays, and NAME.json, the manifest.

{"schema": "iphyre_jax/generated", "version": 1, "kind": "elements", "seed": 0, "protocol": "official", "fps": 10,
 "resets": 2, "dtype": "float32", "scenes": 20000, "drawn": 51234, "refused": {"too easy": 12000, ...},
 "grades": {"below 0.04": 5600, ...}, "nearest_px": 30.1, "provenance": {...}, "sha256": ...}      of NAME.npz
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_option, check_rows, show
from iphyre_jax.data.generated.canvas import BALLS, BARS, FREE, SPRING, Canvas, scene_of
from iphyre_jax.data.generated.drawing import DEFAULT_KIND, KINDS, SceneKind
from iphyre_jax.data.generated.filtering import DTYPE, EASIEST, GRADES, KEPT, REASONS
from iphyre_jax.data.targets import check_path, check_target
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.files import check_exist, file_sum, pack_npz, read_npz, read_versioned, replace_bytes, replace_json
from iphyre_jax.provenance import CORE, provenance
from iphyre_jax.scenes import SPLITS, Scene

SCHEMA: Final = "iphyre_jax/generated"
VERSION: Final = 1
MAX_BYTES: Final = 2**31  # of NAME.npz, and of its arrays
SHIPPED: Final = "shipped"  # stands for the path of the scenes that come with the package, the first of seed 0

Columns = Mapping[str, npt.NDArray[Any]]

ARRAYS: Final[Mapping[str, tuple[str, tuple[int, ...]]]] = {
    "number": ("int64", ()),
    "basic": ("int8", ()),
    "distance": ("float64", ()),
    "plans": ("int16", ()),
    "solved": ("int16", ()),
    "bars": ("float64", (BARS, 2, 2)),
    "balls": ("float64", (BALLS, 3)),
    "n_bars": ("int8", ()),
    "n_balls": ("int8", ()),
    "eliminable": ("bool", (BARS,)),
    "moving": ("bool", (BARS,)),
    "link": ("int8", (BALLS,)),
    "anchor": ("int8", (BALLS,)),
}
BOUNDS: Final[Mapping[str, tuple[float, float]]] = {
    "number": (0, math.inf),
    "basic": (-1, len(SPLITS["basic"]) - 1),
    "distance": (0, math.inf),
    "plans": (1, math.inf),
    "n_bars": (0, BARS),
    "n_balls": (0, BALLS),
    "link": (FREE, SPRING),
    "anchor": (0, BARS - 1),
}


class GeneratorSettings(NamedTuple):
    """What decides the scenes that are drawn and kept, beside their number."""

    seed: int
    protocol: EpisodeProtocol  # rate and reset at which plans are played
    kind: SceneKind


def scene_name(kind: SceneKind, seed: int, number: int) -> str:
    """Return the name of a generated scene."""
    return f"{'generated' if kind == DEFAULT_KIND else kind}~{seed}.{number}"


def scene_columns(canvas: Canvas) -> dict[str, npt.NDArray[Any]]:
    """Return the objects of B scenes as arrays; places without an object hold zeros."""
    used = canvas.used[..., None]
    balls = np.concatenate([canvas.ends[:, BARS:, 0], canvas.radii[:, BARS:, None]], axis=-1)
    return {
        "bars": np.where(used[:, :BARS, None], canvas.ends[:, :BARS], 0.0),
        "balls": np.where(used[:, BARS:], balls, 0.0),
        "n_bars": canvas.bars.astype(np.int8),
        "n_balls": canvas.balls.astype(np.int8),
        "eliminable": canvas.eliminable[:, :BARS],
        "moving": canvas.moving[:, :BARS],
        "link": canvas.link,
        "anchor": canvas.anchor,
    }


@dataclass(frozen=True, eq=False)
class GeneratedScenes:
    """N generated scenes.

    Attributes:
        columns: the scenes and their grades as arrays: number (N,), of each scene among those drawn; basic (N,), the
            basic game that it began with, as an index into the split, -1 for none; distance (N,) px, to the
            nearest test game, inf if none has as many objects of each kind; plans and solved (N,), random plans played,
            and how many of them solve it; and its objects.
        manifest: the fields that the module shows; `save_generated` adds the sum.
    """

    columns: Columns
    manifest: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.columns["number"])

    @classmethod
    def of_chunks(cls, chunks: Sequence[Columns], count: int, settings: GeneratorSettings) -> GeneratedScenes:
        """Return the first `count` scenes of chunks, and how many were drawn until the last of them."""
        columns = {name: np.concatenate([chunk[name] for chunk in chunks])[:count] for name in ARRAYS}
        drawn = int(columns["number"][-1]) + 1
        reasons = np.bincount(np.concatenate([chunk["reason"] for chunk in chunks])[:drawn], minlength=len(REASONS))
        protocol = settings.protocol
        manifest = {
            "schema": SCHEMA,
            "version": VERSION,
            "seed": settings.seed,
            "kind": settings.kind,
            "protocol": protocol.name,
            "fps": protocol.fps,
            "resets": protocol.resets,
            "dtype": DTYPE,
            "scenes": len(columns["number"]),
            "drawn": drawn,
            "refused": {name: int(reasons[k]) for k, name in enumerate(REASONS) if k != KEPT},
            **_facts(columns),
            "provenance": provenance(CORE),
        }
        return cls(columns, manifest)

    @property
    def solve_rate(self) -> npt.NDArray[np.float64]:
        """The share of random plans that solve each scene, (N,) float64.

        Above 0 and at most 0.6, but for unions that solve themselves.
        """
        return np.asarray(self.columns["solved"] / self.columns["plans"])

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes; each is checked as a scene from a file is."""
        numbers = self.columns["number"].tolist()
        return tuple(
            self._scene(row, scene_name(self.manifest["kind"], self.manifest["seed"], k))
            for row, k in enumerate(numbers)
        )

    def select(self, rows: npt.ArrayLike) -> GeneratedScenes:
        """Return some of the scenes; what was drawn and refused stays that of all.

        Args:
            rows: indices or a mask, (N,).

        Raises:
            ValueError: they are not such; one line.
        """
        index = check_rows(rows, len(self))
        columns = {name: column[index] for name, column in self.columns.items()}
        return GeneratedScenes(columns, {**self.manifest, "scenes": len(columns["number"]), **_facts(columns)})

    def _scene(self, row: int, name: str) -> Scene:
        of = {key: column[row] for key, column in self.columns.items()}
        bars, balls = of["bars"][: of["n_bars"]], of["balls"][: of["n_balls"]]
        return scene_of(name, bars, balls, of["eliminable"], of["moving"], of["link"], of["anchor"])


def _facts(columns: Columns) -> dict[str, Any]:
    """Return what a manifest tells of the scenes: how many have each grade, and how near a test game is."""
    nearest = columns["distance"].min(initial=np.inf)
    return {
        "grades": _grade_counts(columns["solved"] / columns["plans"]),
        "nearest_px": float(nearest) if np.isfinite(nearest) else None,
    }


def _grade_counts(rates: npt.NDArray[np.float64]) -> dict[str, int]:
    """Return how many scenes each grade has; above the last are only those that solve themselves."""
    edges = (*GRADES, np.nextafter(EASIEST, 1))
    names = [f"below {edges[0]:g}", *(f"{low:g} to {high:g}" for low, high in pairwise(edges)), f"above {EASIEST:g}"]
    numbers = np.bincount(np.searchsorted(edges, rates, side="right"), minlength=len(names))
    return {name: number for name, number in zip(names, numbers.tolist(), strict=True) if number or name != names[-1]}


def save_generated(scenes: GeneratedScenes, path: str | os.PathLike[str]) -> None:
    """Write generated scenes as NAME.npz and NAME.json; each file is whole at any moment.

    Raises:
        ValueError: the path has another ending, NAME.json is there and is something else, or a column is wrong; one
            line.
        OSError: a file cannot be written.
    """
    npz, manifest = check_target(path, SCHEMA, ARRAYS)
    _check_columns(scenes.columns, len(scenes), "scenes")
    content = pack_npz(scenes.columns)
    replace_bytes(npz, content)
    replace_json(manifest, {**scenes.manifest, "sha256": hashlib.sha256(content).hexdigest()})


def _check_columns(columns: Columns, count: object, source: str) -> None:
    """Refuse columns that no generated scenes have; ValueError in one line."""
    for name, (dtype, shape) in ARRAYS.items():
        column, wanted = columns.get(name), (count, *shape)
        if column is None or str(column.dtype) != dtype or column.shape != wanted:
            got = "none" if column is None else f"{column.dtype} of shape {column.shape}"
            raise ValueError(f"{source}: {name}: expected {dtype} of shape {wanted}, got {got}")
    if unknown := sorted(set(columns) - set(ARRAYS)):
        raise ValueError(f"{source}: {show(unknown[0])}: expected no such array")
    for name, (least, most) in {**BOUNDS, "solved": (0, columns["plans"])}.items():
        wrong = ~((columns[name] >= least) & (columns[name] <= most))  # of NaN too
        if wrong.any():
            limit = "as many as plans" if name == "solved" else most
            raise ValueError(f"{source}: {name}: expected {least} to {limit}, got {columns[name][wrong][0]}")


def generated_file(path: str | os.PathLike[str]) -> Path:
    """Return NAME.npz of a path of generated scenes, or of "shipped"; ValueError in one line for another path."""
    return Path(__file__).with_name("shipped.npz") if str(path) == SHIPPED else check_path(path)[0]


def load_generated(path: str | os.PathLike[str]) -> GeneratedScenes:
    """Read generated scenes; path: of NAME.npz or NAME.json, both must be there, or "shipped", the package's own.

    Raises:
        OSError: a file cannot be read.
        ValueError: a file is not what `save_generated` writes; one line. A wrong scene is refused by `scenes`.
    """
    npz = generated_file(path)
    described = npz.with_suffix(".json")
    check_exist(npz, described)
    manifest = read_versioned(described, SCHEMA, (VERSION,))
    if file_sum(npz) != manifest.pop("sha256", None):
        raise ValueError(f"{npz}: expected the bytes that {described.name} tells of, but they were changed")
    columns = read_npz(npz, MAX_BYTES)
    count = manifest.get("scenes")
    _check_columns(columns, count, str(npz))
    check_option(f"{described}: kind", manifest.setdefault("kind", DEFAULT_KIND), tuple(KINDS))
    if type(manifest.get("seed")) is not int:
        raise ValueError(f"{described}: seed: expected a whole number, got {show(manifest.get('seed'))}")
    return GeneratedScenes(columns, manifest)
