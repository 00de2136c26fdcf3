"""Pictures for language models: the start with numbered blocks, and moments of an attempt. Needs the extra `viewer`."""

from __future__ import annotations

import io
from math import floor
from typing import Final

import numpy as np

from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.checks import missing_extra
from iphyre_jax.rules import DECISIONS_PER_SECOND, NEVER
from iphyre_jax.scenes import Scene
from iphyre_jax.viewer.frames import Camera, Look
from iphyre_jax.viewer.painter import font
from iphyre_jax.viewer.recording import Recording

try:
    from PIL import Image, ImageDraw
except ModuleNotFoundError as error:
    raise missing_extra(__name__, "viewer", error.name) from None

SIZE: Final = 512  # px
MOMENTS: Final = 5  # pictures of an attempt
_ROUNDING: Final = 1e-6  # tenths of a second: ten times 0.3 may be a little less than 3
_LABEL: Final = 20  # px, letters of the numbers
_LOOK: Final = Look("official", SIZE, captions=False, mark=False, fade=0.0)


def start(scene: Scene) -> bytes:
    """Return a PNG, 512 x 512 px, of a scene at its start, the eliminable blocks numbered as plans count them."""
    never = [NEVER] * len(scene.eliminable_blocks)
    return _numbered(Camera(Recording.of_poses(scene, never, scene.start_poses[None]), _LOOK), scene, 0)


def after_removals(scene: Scene, attempt: Attempt) -> list[bytes]:
    """Return five PNG pictures of an attempt with poses, from the first tenth of a second after its last removal on.

    Raises:
        ValueError: the attempt has no poses; one line.
    """
    if attempt.poses is None:
        raise ValueError("attempt: expected one with poses, as the feedback trajectory gives them")
    last = max(min(round(attempt.seconds * DECISIONS_PER_SECOND), len(attempt.poses) - 1), 1)
    played = attempt.poses[: last + 1, : scene.n_objects]
    steps = [NEVER if np.isnan(time) else floor(time * DECISIONS_PER_SECOND + _ROUNDING) for time in attempt.times]
    camera = Camera(Recording.of_poses(scene, steps, played, fps=DECISIONS_PER_SECOND, success=attempt.success), _LOOK)
    first = max((step + 1 for step in steps if NEVER < step < last), default=0)
    return [_numbered(camera, scene, round(frame)) for frame in np.linspace(first, last, MOMENTS)]


def _numbered(camera: Camera, scene: Scene, frame: int) -> bytes:
    """A frame with the numbers of the blocks that are still there."""
    picture: Image.Image = camera.image(frame)
    pen, letters, scale = ImageDraw.Draw(picture), font(_LABEL), SIZE / 600
    for slot, block in enumerate(scene.eliminable_blocks):
        if camera.recording.last_frames[block] >= frame:
            x, y = camera.recording.poses[frame, block, :2] * scale
            pen.text((x, y), str(slot), "black", letters, anchor="mm", stroke_width=3, stroke_fill="white")
    packed = io.BytesIO()
    picture.save(packed, "PNG")
    return packed.getvalue()
