"""The rows of a packed scene: what observations only copy, what they work with, and the world.

All but the world stands in the same rows for all topologies. On a CPU the first part is not read (`traced.cpu_groups`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

from iphyre_jax.envs.batching.scene_features import feature_shapes
from iphyre_jax.execution.layout import Layout
from iphyre_jax.observations.features import Features
from iphyre_jax.physics.types import Topology, World
from iphyre_jax.scenes import Limits

SceneTree = tuple[tuple[Any, Any], tuple[Any, World]]


def scene_tree(features: Features, world: World) -> SceneTree:
    """Return a scene as it is packed."""
    none: Any = None
    return (features.obs_rows, features.candidates), (replace(features, obs_rows=none, candidates=none), world)


def scene_of(tree: SceneTree) -> tuple[Features, World]:
    """Return the features and the world of a `scene_tree`."""
    (obs_rows, candidates), (features, world) = tree
    return replace(features, obs_rows=obs_rows, candidates=candidates), world


@lru_cache(1024)
def scene_layouts(
    topologies: tuple[Topology, ...], topology: Topology, limits: Limits, dtype: str
) -> tuple[Layout, Layout]:
    """Return the layouts of a `scene_tree`, and of all but its first part."""
    tree = scene_tree(feature_shapes(topologies, limits, dtype), World.shapes(topology, dtype))
    return Layout.of(tree, dtype), Layout.of(tree[1], dtype)
