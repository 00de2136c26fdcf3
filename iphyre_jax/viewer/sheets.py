"""Contact sheets: one picture of many plays, at their start or at their end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from iphyre_jax.checks import check_instance, check_whole, is_list, missing_extra, show
from iphyre_jax.memory import check_memory
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.scene import check_is_scene
from iphyre_jax.viewer.frames import MAX_FRAME, Camera, Frame, Look
from iphyre_jax.viewer.painter import blend
from iphyre_jax.viewer.recording import Recording
from iphyre_jax.viewer.themes import theme

try:
    from PIL import Image
except ModuleNotFoundError as error:
    raise missing_extra(__name__, "viewer", error.name) from None

GAP = 6  # px between the pictures
MAX_PICTURES = 400


def contact_sheet(plays: Sequence[Recording], *, columns: int = 8, frame: int = -1, look: Look | None = None) -> Frame:
    """Return one picture of many plays.

    Args:
        plays: 1 to 400 recordings.
        columns: pictures in a row.
        frame: the frame of each play; negative numbers count from the end.
        look: how each picture looks.

    Returns:
        (H, W, 3) uint8.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    if not is_list(plays):
        raise ValueError(f"plays: expected a sequence of recordings, got {show(plays)}")
    if not 0 < len(plays) <= MAX_PICTURES:
        raise ValueError(f"plays: expected 1 to {MAX_PICTURES}, got {len(plays)}")
    check_whole("columns", columns, 1, MAX_PICTURES)
    check_whole("frame", frame, -MAX_FRAME, MAX_FRAME)
    chosen = Look(size=150) if look is None else check_instance("look", look, Look, "a Look")
    for play in plays:
        check_instance("plays", play, Recording, "recordings")
    check_memory("look", 10 * len(plays) * chosen.size**2, "draw fewer or smaller pictures")
    images = [Camera(play, chosen).image(frame) for play in plays]
    width, height = images[0].width + GAP, images[0].height + GAP
    rows, across = -(-len(images) // columns), min(columns, len(images))
    colours = theme(chosen.theme)
    background = blend(colours.text, colours.background, 0.25)
    sheet = Image.new("RGB", (across * width + GAP, rows * height + GAP), background)
    for k, image in enumerate(images):
        sheet.paste(image, (GAP + k % columns * width, GAP + k // columns * height))
    return np.asarray(sheet)


def start_of(scene: Scene, fps: int = 60) -> Recording:
    """Return a recording that holds only the start of a scene; nothing is compiled or played."""
    check_is_scene("scene", scene)
    return Recording.of_poses(scene, [-1] * len(scene.eliminable_blocks), scene.start_poses[None], fps=fps)
