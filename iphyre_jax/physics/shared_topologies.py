"""Topologies that share a program: those of scenes that differ in their pins and springs alone.

A shared topology has the constraints of them all. In a world of it, those that the scene lacks are ABSENT: they never
push, and have no rank in the solve order. So a batch that mixes games needs fewer programs, and each world is played as
by its own: in float64 to the last bit, but for the sign of a zero.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.physics.types import ABSENT, Topology, World
from iphyre_jax.physics.vector import Vec

MOST: Final = 4  # constraints of a shared topology: from three on, a sweep tries each of them at each rank in use

Ends = tuple[tuple[int, int], ...]
Source = npt.NDArray[np.intp]  # (constraints,) index of each constraint in another topology, -1 if it is absent there


def shared_topologies(topologies: Iterable[Topology]) -> tuple[Topology, ...]:
    """Join topologies that differ in their constraints alone, up to MOST of these; their order does not matter."""
    found: list[Topology] = []
    for own in sorted(set(topologies), key=astuple):
        for k, shared in enumerate(found):
            if (joined := _joined(shared, own)) is not None:
                found[k] = joined
                break
        else:
            found.append(own)
    return tuple(found)


def can_play(shared: Topology, own: Topology) -> bool:
    """Return whether worlds of a topology are worlds of a shared one too, with absent constraints."""
    return _source(shared, own) is not None


def with_absent(shared: Topology, own: Topology, world: World) -> World:
    """Return a world (host) of a topology as one of a shared topology.

    Raises:
        ValueError: the shared one lacks a constraint, or has other bodies; one line.
    """
    if shared == own:
        return world
    if (source := _source(shared, own)) is None:
        raise ValueError(f"shared: expected the bodies and constraints of {own}, got {shared}")
    return _rearranged(world, source, len(shared.pins))


def without_absent(shared: Topology, world: World) -> tuple[Topology, World]:
    """Undo `with_absent`: return the topology with the constraints that a world (host) has, and its world."""
    source = np.flatnonzero(np.asarray(world.anchor_static) != ABSENT)
    pins = tuple(shared.constraint_ends[k] for k in source if k < len(shared.pins))
    springs = tuple(shared.constraint_ends[k] for k in source if k >= len(shared.pins))
    return replace(shared, pins=pins, springs=springs), _rearranged(world, source, len(pins))


def _joined(shared: Topology, own: Topology) -> Topology | None:
    """Return the topology with the constraints of both; None if they differ in more, or there are too many."""
    if not _alike(shared, own):
        return None
    joined = replace(shared, pins=_merged(shared.pins, own.pins), springs=_merged(shared.springs, own.springs))
    return joined if len(joined.constraint_ends) <= MOST else None


def _alike(one: Topology, other: Topology) -> bool:
    """Return whether two topologies differ in their constraints alone."""
    first, second = (replace(each, pins=(), springs=()) for each in (one, other))
    return first == second


def _merged(ends: Ends, others: Ends) -> Ends:
    """Return constraints of which both lists are a part, each in its own order."""
    return ends + others[len(_places(ends, others)) :]


def _places(ends: Ends, others: Ends) -> list[int]:
    """Return where the others are in a list, in order, up to the first that does not follow there."""
    places: list[int] = []
    for one in others:
        start = places[-1] + 1 if places else 0
        if one not in ends[start:]:
            break
        places.append(ends.index(one, start))
    return places


@lru_cache(4096)
def _source(shared: Topology, own: Topology) -> Source | None:
    """Return which constraint of its own topology each of a shared one is; None if it cannot play worlds of it."""
    if not _alike(shared, own):
        return None
    pins, springs = _places(shared.pins, own.pins), _places(shared.springs, own.springs)
    if (len(pins), len(springs)) != (len(own.pins), len(own.springs)):
        return None
    source = np.full(len(shared.constraint_ends), -1, np.intp)
    source[[*pins, *(len(shared.pins) + place for place in springs)]] = np.arange(len(own.constraint_ends))
    source.flags.writeable = False  # it is kept
    return source


def _rearranged(world: World, source: Source, pins: int) -> World:
    """Return a world with other constraints, of which the first ones are pins."""

    def taken(leaf: Any, of: Source, fill: int) -> Any:  # noqa: ANN401 - NumPy arrays, which stand for JAX's
        known = np.append(np.asarray(leaf), np.asarray(fill, np.asarray(leaf).dtype))
        return known[of]  # -1 takes the last one, the filling

    return replace(
        world,
        anchor=Vec(*(taken(column, source, 0) for column in (world.anchor.x, world.anchor.y))),
        anchor_static=taken(world.anchor_static, source, ABSENT),
        pin_length=taken(world.pin_length, source[:pins], 0),
    )
