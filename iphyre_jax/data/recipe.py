"""How a data set of plays is made, and which recipes are refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, get_args

import numpy as np

from iphyre_jax.checks import check_flag, check_option, check_resets, check_whole, show, whole_fps
from iphyre_jax.data.arrays import MAX_STEPS
from iphyre_jax.data.dataset import EACH_RESET, SCHEMA, VERSION
from iphyre_jax.data.draws import Plan
from iphyre_jax.data.labels import DTYPE, FRESH, PlayProtocol
from iphyre_jax.memory import check_memory
from iphyre_jax.plans import Rule
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES, TIME_LIMIT
from iphyre_jax.scenes import Scene

DISTRIBUTIONS: Final = ("official", "uniform15", "policy", "mixed")
FORMS: Final = ("fresh", "exact")
POSE_DTYPES: Final = ("float32", "float64")
SPLIT: Final = "train"
MOST_FPS: Final = int(MAX_STEPS / TIME_LIMIT) - 1  # a step's number is an int16
MOST_OF_A_KIND: Final = 100_000
MAX_DRAWS: Final = 20_000  # of a game, by default; few random plans solve seesaw_angle
MOST_DRAWS: Final = 1_000_000
_BYTES_OF_DRAW: Final = 600  # of a plan, its label and its key, in lists and sets

PlanPolicy = Callable[[Scene, int], Iterator[Plan]]
"""Of a scene and a seed: plans without end, s for each slot, NaN for a block that stays."""


@dataclass(frozen=True)
class Recipe:
    """How a data set is made; the keyword arguments of `collect`."""

    distribution: str = "official"
    form: str = "fresh"
    protocol: PlayProtocol = field(default_factory=PlayProtocol)
    seed: int = 0
    max_draws: int = MAX_DRAWS
    policy: PlanPolicy | None = None
    sequences: bool = False
    pose_dtype: str = "float32"
    unique: bool = False
    split: str = SPLIT

    def manifest(self) -> dict[str, Any]:
        """Return the fields of a manifest that say how the plays were made."""
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "distribution": self.distribution,
            "form": self.form,
            "fps": self.protocol.fps,
            "rule": self.protocol.rule,
            "frames": self.protocol.frames,
            "resets": self.protocol.resets if self.form == "fresh" else EACH_RESET,
            "dtype": DTYPE,
            "seed": self.seed,
            "max_draws": self.max_draws,
            "unique": self.unique,
            "split": self.split,
        }


def check_recipe(recipe: Recipe, scenes: Sequence[Scene], successes: int, failures: int) -> Recipe:
    """Return a recipe whose numbers are those of Python; ValueError in one line before anything is drawn."""
    check_whole("successes", successes, 0, MOST_OF_A_KIND)
    check_whole("failures", failures, 0, MOST_OF_A_KIND)
    check_option("distribution", recipe.distribution, DISTRIBUTIONS)
    check_option("form", recipe.form, FORMS)
    check_option("pose_dtype", recipe.pose_dtype, POSE_DTYPES)
    check_flag("sequences", recipe.sequences)
    seed = check_whole("seed", recipe.seed, 0, 2**32 - 1)
    max_draws = check_whole("max_draws", recipe.max_draws, 1, MOST_DRAWS)
    protocol = recipe.protocol
    rate = whole_fps(protocol.fps)
    check_option("rule", protocol.rule, get_args(Rule))
    resets = check_resets(protocol.resets)
    if rate > MOST_FPS or (recipe.sequences and rate % DECISIONS_PER_SECOND):
        wanted = f"at most {MOST_FPS}, with sequences a multiple of {DECISIONS_PER_SECOND}"
        raise ValueError(f"fps: expected {wanted}, got {show(protocol.fps)}")
    if rate % DECISIONS_PER_SECOND and protocol.rule != "simulate":
        raise ValueError(f"fps: expected a multiple of {DECISIONS_PER_SECOND} for the rule in_advance, got {rate}")
    if (recipe.distribution == "policy") != callable(recipe.policy):
        raise ValueError(f"policy: expected a function for the distribution policy only, got {show(recipe.policy)}")
    if recipe.form == "exact" and (recipe.unique or protocol.resets != FRESH):
        wanted = f"fresh for the distribution {recipe.distribution} and resets {protocol.resets}"
        raise ValueError(f"form: expected {wanted}, got exact")
    draws = min(max_draws, 1000 * (successes + failures))
    check_memory("max_draws", len(scenes) * draws * _BYTES_OF_DRAW, "collect fewer games at a time")
    check_poses(recipe, scenes, len(scenes) * (successes + failures))
    return replace(recipe, seed=seed, max_draws=max_draws, protocol=replace(protocol, fps=rate, resets=resets))


def check_poses(recipe: Recipe, scenes: Sequence[Scene], plays: int) -> None:
    """Refuse so many plays if the recipe has sequences and memory does not suffice; ValueError in one line."""
    if recipe.sequences:
        check_memory("sequences", 2 * pose_bytes(scenes, plays, recipe.pose_dtype), "collect fewer plays at a time")


def pose_bytes(scenes: Sequence[Scene], plays: int, dtype: str) -> int:
    """Return the bytes of the poses of so many plays."""
    movers = max(int(scene.dynamic.sum()) for scene in scenes)
    return plays * FRAMES * movers * 3 * (np.dtype(dtype).itemsize + 8)
