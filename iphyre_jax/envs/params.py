"""Scenes as the data of an environment, and the state of an episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.features import Features, scene_tables
from iphyre_jax.envs.mixture import Games, Mixture
from iphyre_jax.envs.protocols import Protocol
from iphyre_jax.envs.stretches import start
from iphyre_jax.physics.types import World
from iphyre_jax.programs import built
from iphyre_jax.rollouts import Progress
from iphyre_jax.scenes import Scene

SceneLike = str | PathLike[str] | Scene
Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvParams:
    """The games of an environment, one a row of every array; an episode begins with one of them at random."""

    table: Games  # as the solver reads them
    start: Progress  # before the first step
    features: Features  # what an observation needs

    @property
    def games(self) -> int:
        """The number of games."""
        return self.table.kind.shape[-1]

    @property
    def world(self) -> World:
        """The games as worlds of the solver."""
        return self.table.world


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvState:
    """An episode of one game."""

    progress: Progress  # of the physics
    game: jax.Array  # () int32, row of the parameters
    used: jax.Array  # (slots,) bool, slots that a combined plan has executed


def mixture_of(scenes: Sequence[Scene], protocol: Protocol, dtype: str) -> Mixture:
    """Return the topologies of some scenes."""
    with jax.enable_x64(dtype == "float64"):
        return Mixture.of([built(scene, protocol.resets, dtype) for scene in scenes])


def make_params(scenes: Sequence[Scene], mixture: Mixture, protocol: Protocol, dtype: str) -> EnvParams:
    """Return scenes as parameters.

    Args:
        scenes: at least one.
        mixture: of an environment; all scenes must be of its topologies.
        protocol: of the environment.
        dtype: of the physics, "float32" or "float64".

    Raises:
        ValueError: a scene's topology is not of the mixture; one line.
    """
    kinds: list[int] = []
    rows: list[tuple[World, Progress]] = []
    with jax.enable_x64(dtype == "float64"):
        for scene in scenes:
            topology, world = built(scene, protocol.resets, dtype)
            if topology not in mixture.topologies:
                raise ValueError(
                    f"scenes: expected topologies of this environment, but {scene.name} has another; "
                    "make the environment with this scene among its own"
                )
            kinds.append(mixture.topologies.index(topology))
            rows.append((mixture.world.fill(world), mixture.progress.fill(start(topology, world))))
        world, progress = _table(rows)
        features = _table([scene_tables(scene, mixture, dtype) for scene in scenes])
        return EnvParams(Games(world, jnp.asarray(kinds, jnp.int32)), progress, features)


def _table(rows: Sequence[Tree]) -> Tree:
    """Stack trees of arrays row by row, on the device."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *rows)


def row(table: Tree, index: jax.Array) -> Tree:
    """Return one row of every array of a tree."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], table)
