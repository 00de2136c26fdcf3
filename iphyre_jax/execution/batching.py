"""Group worlds of many scenes: a group is worlds of one topology that run side by side, one a lane.

Everything that plays many worlds outside the user's program groups them here. `envs.traced.sorting` does the same
inside a traced program.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.layout import Words, fill_lanes
from iphyre_jax.execution.programs import SPARE, world_layout
from iphyre_jax.physics.types import Topology, World
from iphyre_jax.scenes import MAX_ELIMINABLE
from iphyre_jax.scenes.compile import compile_scene
from iphyre_jax.scenes.scene import Scene

SCENES_KEPT: Final = 4096  # compiled scenes; some kilobytes each

Indices = npt.NDArray[np.integer[Any]]


@lru_cache(SCENES_KEPT)
def cached_world(scene: Scene, resets: int, dtype: str) -> tuple[Topology, World]:
    """Return the topology and the world of a scene, without lanes; the last SCENES_KEPT are cached."""
    return compile_scene(scene, resets=resets, dtype=dtype)


def plan_slots_for(plan: npt.NDArray[np.int32]) -> int:
    """Return the plan slots of a program for plans (B, S): the same number for all scenes of official limits."""
    return max(MAX_ELIMINABLE, plan.shape[1])


@dataclass(frozen=True, eq=False)
class Group:
    """Worlds of one topology that run side by side."""

    topology: Topology
    scene_index: Indices  # (n,) scene of each world
    rows: Indices  # (n,) the caller's row of each world
    columns: Indices  # (n,) column of each world in `table`
    table: Words  # (words, scenes) packed worlds of the topology's scenes

    def worlds(self, lanes: int) -> Words:
        """Return the packed worlds, (words, lanes); spare lanes repeat the last world."""
        return self.table.take(fill_lanes(self.columns, lanes), axis=1)

    def plans(self, plan: npt.NDArray[np.int32], plan_slots: int, lanes: int) -> npt.NDArray[np.int32]:
        """Return the plans of the worlds, (plan_slots, lanes) int32, SPARE in spare lanes; plan: (B, S), all rows."""
        out = np.full((plan_slots, lanes), -1, np.int32)
        out[: plan.shape[1], : len(self.rows)] = plan[self.rows].T
        out[:, len(self.rows) :] = SPARE
        return out


def lane_slices(count: int, lanes: int) -> list[slice]:
    """Cut so many worlds into groups of at most `lanes`."""
    return [slice(start, min(start + lanes, count)) for start in range(0, count, lanes)]


def group_by_topology(
    worlds: Sequence[tuple[Topology, World]],
    scene_index: Indices,
    rows: Indices,
    dtype: str,
    lanes: Callable[[Topology], int],
    order: Callable[[Indices], Indices] = lambda rows: rows,
) -> list[Group]:
    """Sort worlds by topology, then scene, and cut them into groups; the groups with the most moving bodies come first.

    Args:
        worlds: of each scene, as `cached_world` returns them.
        scene_index: (B,) scene of each row.
        rows: the rows to play.
        dtype: of the worlds.
        lanes: the most worlds in a group of a topology.
        order: sorts the rows of one scene.
    """
    members: dict[Topology, list[int]] = {}
    for k in np.unique(scene_index[rows]).tolist():
        members.setdefault(worlds[k][0], []).append(k)
    groups = []
    for topology, scenes in sorted(members.items(), key=lambda item: -item[0].moving):
        table = world_layout(topology, dtype).pack_many([worlds[k][1] for k in scenes])
        sorted_rows = np.concatenate([order(rows[scene_index[rows] == k]) for k in scenes])
        columns = np.searchsorted(scenes, scene_index[sorted_rows])
        for part in lane_slices(len(sorted_rows), lanes(topology)):
            own = sorted_rows[part]
            groups.append(Group(topology, scene_index[own], own, columns[part], table))
    return groups
