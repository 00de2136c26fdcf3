"""What is compiled for the environments on a CPU: one decision of worlds of one topology, side by side.

A row is an episode: the words of its status, then those of its physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Final

import jax
import jax.numpy as jnp

from iphyre_jax import rollouts
from iphyre_jax.envs.features import Features, feature_shapes
from iphyre_jax.envs.observations import ObservationName, observation_size, observe
from iphyre_jax.envs.status import status_of, status_rows, status_words
from iphyre_jax.envs.stretches import Stretch, play_lanes
from iphyre_jax.execution import programs
from iphyre_jax.execution.layout import WORD, Layout
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import Progress
from iphyre_jax.scenes import Limits

BLOCK: Final = 48  # rows that are turned over at a time: as many lines as the first cache holds of rows 512 bytes apart
BEGIN: Final = -1  # in place of a step to play to: the episode begins, and nothing is played


@lru_cache(1024)
def scene_layout(topology: Topology, limits: Limits, dtype: str) -> Layout:
    """Return the layout of a scene: its world and its features."""
    tree = World.shapes(topology, dtype), feature_shapes(topology, limits, dtype)
    return Layout.of(tree, dtype)


@dataclass(frozen=True)
class EnvStep:
    """One decision of worlds of one topology, whatever the strategy: it gets plans and steps to play to.

    Attributes:
        topology: of the worlds.
        dtype: of the physics.
        lanes: worlds side by side.
        observation: "official" or "motion", see `observations`.
        limits: rows of the official table, slots of a plan.
        no_op: whether a candidate that does nothing stands before the blocks'.
    """

    sources: ClassVar[tuple[str, ...]] = (
        *programs.SOURCES,
        *(f"envs/{name}.py" for name in ("step_program", "status", "features", "observations", "stretches")),
    )

    topology: Topology
    dtype: str
    lanes: int
    observation: ObservationName
    limits: Limits
    no_op: bool

    @property
    def row(self) -> int:
        """Words of an episode."""
        return status_words(self.limits.blocks) + programs.progress_layout(self.topology, self.dtype).rows

    @property
    def seen(self) -> int:
        """Numbers of an observation."""
        candidates = self.limits.blocks + self.no_op
        return observation_size(self.observation, self.limits.objects, candidates)

    @property
    def order(self) -> int:
        """Words of what a world is to do: a plan, the step to play to or BEGIN, and the slots executed then."""
        return 2 * self.limits.blocks + 1

    def arguments(self) -> programs.Shapes:
        """Return the shapes of scenes (words, lanes), worlds (lanes, row + order), clock, and counts (2,).

        The words of scenes are those of `scene_layout`. A row of worlds is an episode and its order. The counts are the
        steps of a whole episode, and 1.
        """
        scene = scene_layout(self.topology, self.limits, self.dtype)
        return (
            jax.ShapeDtypeStruct((scene.rows, self.lanes), scene.word),
            jax.ShapeDtypeStruct((self.lanes, self.row + self.order), scene.word),
            jax.ShapeDtypeStruct((programs.CLOCK,), self.dtype),
            jax.ShapeDtypeStruct((2,), "int32"),
        )

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return episodes as they are then, and the bits of their observations, (lanes, row + seen)."""
        scenes, worlds, numbers, counts = arguments
        steps, once = counts[0], counts[1]
        timing = programs.timing_of(numbers)

        def play(scenes: jax.Array, worlds: jax.Array) -> jax.Array:
            world, features = scene_layout(self.topology, self.limits, self.dtype).unpack(scenes)
            tables = self._play(world, features, worlds.T, timing, steps, once)
            return _turned_over(tables, jnp.zeros((self.lanes, self.row + self.seen), worlds.dtype))

        like = jax.ShapeDtypeStruct((self.lanes, self.row + self.seen), worlds.dtype)
        return (programs.in_one_function(play, (scenes, worlds), like, once),)

    def _play(
        self, world: World, features: Features, worlds: jax.Array, timing: Timing, steps: jax.Array, once: jax.Array
    ) -> tuple[jax.Array, ...]:
        """Return words and numbers of the episodes, and parts of what is seen of them; all have lanes behind."""
        blocks, first = self.limits.blocks, status_words(self.limits.blocks)
        layout = programs.progress_layout(self.topology, self.dtype)
        episodes, orders = worlds[: self.row], worlds[self.row :].astype(jnp.int32)
        plan, until, executed = orders[:blocks], orders[blocks], orders[blocks + 1 :] != 0
        progress = _begun(self.topology, world, until == BEGIN, layout.unpack(episodes[first:]))
        until = jnp.where(until == BEGIN, progress.state.step, until)
        stretch = Stretch(episodes[0].astype(jnp.int32), plan, until)
        progress = play_lanes(self.topology, timing, world, stretch, progress)
        status = status_of(stretch.game, world, progress, executed)

        def tables() -> tuple[jax.Array, ...]:
            whole, numbers = layout.parts(progress)
            # Many rows: of a few arrays the compiler would choose one for each number.
            words = jnp.concatenate([*(row.astype(worlds.dtype)[None] for row in status_rows(status)), whole])
            seen = observe(self.observation, features, status.standing, progress, steps, no_op=self.no_op)
            return words, numbers, *seen

        # In a branch of its own, always taken: else it is made number by number while it is turned over.
        blank = [jnp.zeros(part.shape, part.dtype) for part in jax.eval_shape(tables)]
        return jax.lax.cond(once == 1, tables, lambda: tuple(blank))


def _turned_over(tables: Sequence[jax.Array], out: jax.Array) -> jax.Array:
    """Return tables (rows, lanes) one beside the other, (lanes, rows), their bits as words of `out`."""
    column = 0
    for table in tables:
        for start in range(0, table.shape[0], BLOCK):
            part = table[start : start + BLOCK].T
            if jnp.issubdtype(part.dtype, jnp.floating):
                part = jax.lax.bitcast_convert_type(part, WORD[part.dtype.name])
            out = jax.lax.dynamic_update_slice(out, part.astype(out.dtype), (0, column))
            column += part.shape[1]
    return out


def _begun(topology: Topology, world: World, begins: jax.Array, progress: Progress) -> Progress:
    """Return episodes, those that begin as they are before their first step."""

    def fresh() -> Progress:
        start = rollouts.begin(topology, world, jnp.zeros_like(begins))
        return jax.tree.map(lambda new, old: jnp.where(jnp.broadcast_to(begins, old.shape), new, old), start, progress)

    return jax.lax.cond(jnp.any(begins), fresh, lambda: progress)
