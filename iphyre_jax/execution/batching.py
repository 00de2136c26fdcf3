"""Worlds of many scenes, sorted into groups that run side by side: one topology each, at most so many lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.layout import Words, filled
from iphyre_jax.execution.programs import SPARE, world_layout
from iphyre_jax.physics.types import Topology, World
from iphyre_jax.scenes import MAX_ELIMINABLE
from iphyre_jax.scenes.compile import compile_scene
from iphyre_jax.scenes.scene import Scene

SCENES_KEPT: Final = 4096  # compiled scenes; some kilobytes each

Indices = npt.NDArray[np.integer[Any]]


@lru_cache(SCENES_KEPT)
def cached_world(scene: Scene, resets: int, dtype: str) -> tuple[Topology, World]:
    """Return topology and numbers of a scene, without lanes; kept while it is among the last SCENES_KEPT asked for."""
    return compile_scene(scene, resets=resets, dtype=dtype)


def plan_slots_for(plan: npt.NDArray[np.int32]) -> int:
    """Return how many columns a program has that plays plans (B, S): as many for all scenes of official limits."""
    return max(MAX_ELIMINABLE, plan.shape[1])


@dataclass(frozen=True, eq=False)
class Group:
    """Worlds of one topology that run side by side.

    Attributes:
        topology: of all of them.
        scene: (used,) index of the scene of each world.
        rows: (used,) the caller's row of each.
        columns: (used,) the table's column of each.
        table: words of the topology's scenes, (rows of the layout, scenes).
    """

    topology: Topology
    scene: Indices
    rows: Indices
    columns: Indices
    table: Words

    def worlds(self, lanes: int) -> Words:
        """Return the words of the worlds, (rows of the layout, lanes); spare lanes repeat the last one."""
        return np.ascontiguousarray(self.table[:, filled(self.columns, lanes)])

    def plans(self, plan: npt.NDArray[np.int32], columns: int, lanes: int) -> npt.NDArray[np.int32]:
        """Return the plans of the worlds, (columns, lanes) int32; SPARE in spare lanes.

        plan: (B, S) of the caller's rows.
        """
        out = np.full((columns, lanes), -1, np.int32)
        out[: plan.shape[1], : len(self.rows)] = plan[self.rows].T
        out[:, len(self.rows) :] = SPARE
        return out


def group_by_topology(
    worlds: Sequence[tuple[Topology, World]],
    scene: Indices,
    rows: Indices,
    dtype: str,
    lanes: Callable[[Topology], int],
    order: Callable[[Indices], Indices] = lambda rows: rows,
) -> list[Group]:
    """Sort worlds by topology, then scene, and cut them into groups; those of most moving bodies come first.

    Args:
        worlds: of the scenes, as of `cached_world`.
        scene: (B,) index of the scene of each row.
        rows: the rows wanted.
        dtype: of the worlds.
        lanes: most worlds of a group of a topology.
        order: brings the rows of one scene into the order in which they are to stand.
    """
    members: dict[Topology, list[int]] = {}
    for k in np.unique(scene[rows]).tolist():
        members.setdefault(worlds[k][0], []).append(k)
    groups = []
    for topology, scenes in sorted(members.items(), key=lambda item: -item[0].moving):
        table = world_layout(topology, dtype).pack_many([worlds[k][1] for k in scenes])
        sorted_rows = np.concatenate([order(rows[scene[rows] == k]) for k in scenes])
        columns = np.searchsorted(scenes, scene[sorted_rows])
        for start in range(0, len(sorted_rows), lanes(topology)):
            part = slice(start, start + lanes(topology))
            here = sorted_rows[part]
            groups.append(Group(topology, scene[here], here, columns[part], table))
    return groups
