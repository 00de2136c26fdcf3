"""What observations need of a scene, as numbers to pack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from iphyre_jax.observations.features import Features
from iphyre_jax.observations.official import COLUMNS
from iphyre_jax.physics.types import Topology
from iphyre_jax.scenes import Limits


def feature_shapes(topologies: Sequence[Topology], limits: Limits, dtype: str) -> Features:
    """Return the shapes of `feature_numbers` of scenes of some topologies, padded to the largest."""

    def most(count: Callable[[Topology], int]) -> int:
        return max(map(count, topologies))

    def array(*shape: int, of: str = dtype) -> Any:  # noqa: ANN401 - it stands for an array
        return jax.ShapeDtypeStruct(shape, of)

    objects, blocks, bars = limits.objects, limits.blocks, most(lambda topology: topology.bars)
    return Features(
        object_rows=None,
        obs_rows=array(objects, COLUMNS),
        mover=array(most(lambda topology: topology.moving), of="int32"),
        ends=array(bars, 2, 2),
        slot_object=array(blocks, of="int32"),
        joints=array(most(lambda topology: len(topology.pins)), objects, of="bool"),
        springs=array(most(lambda topology: len(topology.springs)), objects, of="bool"),
        candidates=array(blocks, 2),
    )


def feature_numbers(features: Features, dtype: str) -> Features:
    """Return features (NumPy) with numbers of one dtype, without those that only pictures need."""
    numbers: dict[str, Any] = {name: np.asarray(getattr(features, name), dtype) for name in ("obs_rows", "candidates")}
    return replace(features, object_rows=None, **numbers)
