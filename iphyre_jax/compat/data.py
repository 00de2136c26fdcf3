"""The files that the official class collects: start scenes and sequences of states, with pictures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import is_list, missing_extra, show
from iphyre_jax.memory import check_memory

if TYPE_CHECKING:
    from iphyre_jax.compat.simulator import IPHYRE


def save_start(simulator: IPHYRE, save_path: str, images: bool) -> None:
    """Save the start of a game in the folder save_path/game: `raw.npz`, `vectors.npy` and GAME.jpg.

    `vectors.npy` is the table (12, 9) of the official class. `raw.npz` holds balls, blocks, eli and dynamic, which the
    official class pickles as `raw.npy`; this package writes no pickles.

    Args:
        simulator: the game; it is reset.
        save_path: the folder; made if it is missing.
        images: save the picture, which needs the extra `viewer`.

    Raises:
        ModuleNotFoundError: pillow is missing; one line that names the extra.
        OSError: a file cannot be written.
    """
    simulator.reset()
    folder = _save_raw(simulator, save_path)
    np.save(folder / "vectors.npy", simulator.get_all_property())
    if images:
        _save_picture(folder / f"{simulator.game}.jpg", simulator.picture())


def save_sequences(
    simulator: IPHYRE, save_path: str, act_lists: Sequence[Sequence[Sequence[float]]], fps: int, images: bool
) -> None:
    """Save the states under each list of timed clicks in save_path/game/number.

    A folder holds `actions.npy`, (clicks, 3) x, y, t sorted by time; `vectors.npy`, (15 fps, 12, 9) tables, zeros after
    the end; and `images/number.jpg`. A folder that exists stays as it is, as with the official class.

    Args:
        simulator: the game; it is reset for each list.
        save_path: the folder; made if it is missing.
        act_lists: lists of clicks (x, y, t).
        fps: states saved a second, a divisor of the simulator's rate.
        images: save the pictures, which needs the extra `viewer`.

    Raises:
        ValueError: fps does not divide the simulator's rate; one line.
        ModuleNotFoundError: pillow is missing; one line that names the extra.
        OSError: a file cannot be written.
    """
    if isinstance(fps, bool) or not isinstance(fps, int) or fps < 1 or simulator.FPS % fps:
        raise ValueError(f"fps: expected a divisor of the simulator's {simulator.FPS}, got {show(fps)}")
    if not is_list(act_lists):
        raise ValueError(f"act_lists: expected a sequence of lists of clicks, got {show(act_lists)}")
    every, count = int(simulator.FPS // fps), simulator.max_time * fps
    check_memory("fps", count * simulator.max_obj_num * 9 * 8, "save fewer states a second")
    game = _save_raw(simulator, save_path)
    for number, clicks in enumerate(act_lists):
        simulator.reset()
        folder = game / str(number)
        if folder.exists():
            continue
        removals = simulator.removals(clicks)
        (folder / "images").mkdir(parents=True)
        vectors = np.zeros((count, simulator.max_obj_num, 9))
        np.save(folder / "actions.npy", np.array(sorted(map(list, clicks), key=lambda click: click[2])).reshape(-1, 3))
        made = 0
        for k in range(count):
            made, solved = simulator.run_plan(removals, made, k * every)
            if solved:
                break
            vectors[k] = simulator.get_all_property()
            if images:
                _save_picture(folder / "images" / f"{k}.jpg", simulator.picture())
        np.save(folder / "vectors.npy", vectors)


def _save_raw(simulator: IPHYRE, save_path: str) -> Path:
    if not isinstance(save_path, str | os.PathLike) or "\0" in str(save_path):
        raise ValueError(f"save_path: expected the path of a folder, got {show(save_path)}")
    folder = Path(save_path) / simulator.game
    folder.mkdir(parents=True, exist_ok=True)
    scene = simulator.scene
    np.savez(
        folder / "raw.npz",
        balls=scene.balls,
        blocks=scene.blocks,
        eli=scene.eliminable.astype(np.int64),
        dynamic=scene.dynamic.astype(np.int64),
    )
    return folder


def _save_picture(path: Path, pixels: npt.NDArray[np.uint8]) -> None:
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise missing_extra("a picture (images=False makes none)", "viewer", "PIL") from None
    Image.fromarray(pixels).save(path)
