"""The arrays of a data set of plays: their names, types and shapes, and which numbers they may hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import is_list, show
from iphyre_jax.plans import Rule, official_clock
from iphyre_jax.rules import FRAMES, NEVER, TIME_LIMIT
from iphyre_jax.scenes import Scene

MAX_STEPS: Final = np.iinfo(np.int16).max  # of a play
ARRAYS: Final = {
    "game": ("int32",),
    "times": ("float32",),
    "steps": ("int16",),
    "success": ("bool",),
    "end_step": ("int16",),
    "removals": ("int8",),
    "draw": ("int32",),
    "poses": ("float32", "float64"),
}


def frames_of(fps: int, rule: Rule) -> int:
    """Return the steps of a whole play: 900 at 60 a second; at 10 150, or 151 by the clock of the rule "simulate"."""
    return len(official_clock(fps)) if rule == "simulate" else round(TIME_LIMIT * fps)


def check_arrays(
    arrays: Mapping[str, npt.NDArray[Any]], scenes: Sequence[Scene], manifest: Mapping[str, Any], source: str
) -> None:
    """Refuse arrays that no data set of such scenes, and of such a manifest, has.

    Raises:
        ValueError: see `check_shapes`, or an array holds other numbers.
    """
    check_shapes(arrays, scenes, manifest, source)
    _check_numbers(arrays, len(scenes), frames_of(manifest["fps"], manifest["rule"]), source)


def check_shapes(
    arrays: Mapping[str, npt.NDArray[Any]], scenes: Sequence[Scene], manifest: Mapping[str, Any], source: str
) -> None:
    """Refuse arrays whose names, types or shapes no data set of such scenes has; their numbers may be wrong.

    Raises:
        ValueError: an array is missing or unknown, or has another type or shape; one line that begins with `source` and
            names the array.
    """
    if not is_list(scenes) or len(scenes) != len(manifest["scenes"]):
        raise ValueError(f"{source}: scenes: expected {len(manifest['scenes'])} as in the manifest")
    if unknown := sorted(set(arrays) - set(ARRAYS)):
        raise ValueError(f"{source}: {show(unknown[0])}: expected no such array")
    _check_sides(arrays, source)
    if arrays["times"].shape != arrays["steps"].shape:
        raise ValueError(f"{source}: steps: expected the shape of times, {arrays['times'].shape}")
    slots = max((len(scene.eliminable_blocks) for scene in scenes), default=0)
    if arrays["times"].shape[1] < slots:
        raise ValueError(f"{source}: times: expected {slots} columns or more, got {arrays['times'].shape[1]}")
    movers = max((int(scene.dynamic.sum()) for scene in scenes), default=0)
    if "poses" in arrays and (arrays["poses"].shape[1] != FRAMES or arrays["poses"].shape[2] < movers):
        got = arrays["poses"].shape
        raise ValueError(f"{source}: poses: expected shape (N, {FRAMES}, {movers} or more, 3), got {got}")


def _check_sides(arrays: Mapping[str, npt.NDArray[Any]], source: str) -> None:
    count = len(arrays["game"]) if "game" in arrays and arrays["game"].ndim else 0
    shapes = {"times": (count, None), "steps": (count, None), "poses": (count, None, None, 3)}
    for name, dtypes in ARRAYS.items():
        if name == "poses" and name not in arrays:
            continue
        wanted, array = shapes.get(name, (count,)), arrays.get(name)
        fits = array is not None and array.ndim == len(wanted)
        if array is None or str(array.dtype) not in dtypes or not fits or _differs(array.shape, wanted):
            shape = ", ".join("any" if side is None else str(side) for side in wanted)
            got = "none" if array is None else f"{array.dtype} of shape {array.shape}"
            raise ValueError(f"{source}: {name}: expected {dtypes[0]} of shape ({shape}), got {got}")


def _differs(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return any(side not in (None, length) for length, side in zip(shape, wanted, strict=True))


def _check_numbers(arrays: Mapping[str, npt.NDArray[Any]], scenes: int, frames: int, source: str) -> None:
    bounds = {
        "game": (0, scenes - 1, f"indices into {scenes} scenes"),
        "times": (0, np.finfo(np.float32).max, "seconds from 0 on, or NaN for never"),
        "steps": (NEVER, MAX_STEPS, "steps from 0 on, or -1 for never"),
        "end_step": (0, frames, f"0 to {frames} steps"),
        "draw": (0, np.iinfo(np.int32).max, "numbers from 0 on"),
    }
    for name, (least, most, what) in bounds.items():
        array = arrays[name]
        if (wrong := array[(array < least) | (array > most)]).size:
            raise ValueError(f"{source}: {name}: expected {what}, got {wrong[0]}")
