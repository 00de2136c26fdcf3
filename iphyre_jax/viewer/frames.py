"""Turn recordings into frames, with captions, trails, fading blocks, a mark at the end, and plays side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import (
    check_flag,
    check_instance,
    check_least,
    check_whole,
    is_list,
    missing_extra,
    one_line,
    show,
)
from iphyre_jax.viewer.painter import SUPERSAMPLING, Painter, blend, font
from iphyre_jax.viewer.recording import Recording
from iphyre_jax.viewer.themes import Theme, theme

try:
    from PIL import Image, ImageDraw
except ModuleNotFoundError as error:
    raise missing_extra(__name__, "viewer", error.name) from None

GAP = 8  # px between two pictures
TRAIL_POINTS = 60  # most lines in a trail
MIN_SIZE, MAX_SIZE = 64, 2000  # px
MAX_TITLE = 60  # characters
MAX_SECONDS = 60
MAX_FRAME = 10**9
ROOMY = 300  # px; captions of smaller pictures are shortened

Frame = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Look:
    """How frames look.

    Args:
        theme: "modern", "dark" or "official".
        size: px, side of one picture, which shows 600 px of the scene.
        captions: whether a line above the picture shows title, time and result.
        trails: whether to show the paths of the balls in the last `trail_seconds`.
        fade: s, how long a removed block fades; 0 for no fading.
        mark: whether the last frame shows a tick or a cross.
        trail_seconds: length of the trails, s.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """

    theme: str = "modern"
    size: int = 600
    captions: bool = True
    trails: bool = False
    fade: float = 0.4
    mark: bool = True
    trail_seconds: float = 4.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        theme(self.theme)
        check_whole("size", self.size, MIN_SIZE, MAX_SIZE, "px")
        for name in ("fade", "trail_seconds"):
            check_least(name, getattr(self, name), 0, MAX_SECONDS, "seconds")
        for name in ("captions", "trails", "mark"):
            check_flag(name, getattr(self, name))

    @property
    def caption_height(self) -> int:
        """Height of the caption, px: an even number, 0 without captions."""
        return max(18, 2 * round(self.size * 0.03) + 4) if self.captions else 0


class Camera:
    """Draws the frames of one play.

    Args:
        recording: the play.
        look: how frames look.
        title: of the caption; by default the name of the scene.
    """

    def __init__(self, recording: Recording, look: Look | None = None, title: str | None = None) -> None:
        self.recording, self.look = recording, look or Look()
        self.title = one_line(recording.scene.name if title is None else title)[:MAX_TITLE]
        self.colours: Theme = theme(self.look.theme)
        self._painter = Painter(recording.scene, self.colours, self.look.size)
        self._last_frames = recording.last_frames

    def image(self, frame: int) -> Image.Image:
        """Draw one frame. Numbers after the last frame show the last frame; negative ones count from the end."""
        recording = self.recording
        k = min(frame, recording.steps) if frame >= 0 else max(recording.steps + 1 + frame, 0)
        picture = self._painter.paint(
            recording.poses[k], self._last_frames >= k, fading=self._fading(k), trails=self._trails(k)
        )
        if self.look.mark and k == recording.steps and recording.steps > 0:
            self._mark(picture)
        return self._captioned(picture, k) if self.look.captions else picture

    def _fading(self, k: int) -> dict[int, float]:
        """Return the opacity of each removed block that still fades, 0 to 1."""
        length = self.look.fade * self.recording.fps
        ago = k - self._last_frames
        return {int(i): 1 - ago[i] / length for i in np.flatnonzero((ago > 0) & (ago < length))}

    def _trails(self, k: int) -> list[npt.NDArray[np.floating]]:
        """Return the recent path of each ball, px."""
        if not self.look.trails or k == 0:
            return []
        first = max(0, k - round(self.look.trail_seconds * self.recording.fps))
        at = np.unique(np.linspace(first, k, min(TRAIL_POINTS, k - first) + 1).round().astype(int))
        return list(self.recording.poses[at][:, self.recording.scene.n_blocks :, :2].transpose(1, 0, 2))

    def _mark(self, picture: Image.Image) -> None:
        """Put a tick or a cross into the upper right corner; their shapes differ, not only their colours."""
        side = round(self.look.size * 0.08) * SUPERSAMPLING
        solved = self.recording.success
        disc = Image.new("RGBA", (side, side))
        pen = ImageDraw.Draw(disc)
        pen.ellipse((0, 0, side - 1, side - 1), fill=self.colours.solved if solved else self.colours.failed)
        lines = _TICK if solved else _CROSS
        for line in lines:
            points = [(x * side, y * side) for x, y in line]
            pen.line(points, (255, 255, 255), max(1, round(side * 0.11)), joint="curve")
        small = disc.reduce(SUPERSAMPLING)
        edge = round(self.look.size * 0.025)
        picture.paste(small, (self.look.size - edge - small.width, edge), small)

    def _captioned(self, picture: Image.Image, k: int) -> Image.Image:
        """Put the caption above the picture: the title at the left, result and time at the right."""
        colours, height, recording = self.colours, self.look.caption_height, self.recording
        whole = Image.new("RGB", (picture.width, picture.height + height), colours.background)
        whole.paste(picture, (0, height))
        pen, letters = ImageDraw.Draw(whole), font(max(11, round(height * 0.5)), ascii_only=self.title.isascii())
        ground = blend(colours.text, colours.background, 0.06)
        pen.rectangle((0, 0, whole.width, height - 1), ground)
        state, colour = f"{k / recording.fps:.2f} s" if recording.steps else "", colours.quiet
        if k == recording.steps and recording.steps > 0:
            word = "solved" if recording.success else "not solved"
            state = f"{word}  {recording.reward:.2f}  {state}" if self.look.size >= ROOMY else f"{recording.reward:.1f}"
            colour = colours.solved if recording.success else colours.failed
        left = round(height * 0.35)
        pen.text((left, height / 2), self.title, colours.text, letters, anchor="lm")
        # The result has its own background, so that it covers a title that is too long.
        start = whole.width - left - pen.textlength(state, letters)
        pen.rectangle((start - left, 0, whole.width, height - 1), ground)
        pen.text((start, height / 2), state, colour, letters, anchor="lm")
        return whole


_TICK = (((0.26, 0.52), (0.44, 0.70), (0.76, 0.34)),)
_CROSS = (((0.32, 0.32), (0.68, 0.68)), ((0.68, 0.32), (0.32, 0.68)))


Recordings = Recording | Sequence[Recording]


def still(
    plays: Recordings, look: Look | None = None, titles: Sequence[str] | None = None, *, frame: int = -1
) -> Frame:
    """Return one frame of one play, or of several side by side.

    Args:
        plays: one or more recordings of one frame rate.
        look: how frames look.
        titles: one for each play; by default the names of the scenes.
        frame: the number of the frame; negative ones count from the end. A shorter play shows its last frame.

    Returns:
        (H, W, 3) uint8.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    check_whole("frame", frame, -MAX_FRAME, MAX_FRAME)
    cameras = _cameras(plays, look, titles)
    return np.asarray(side_by_side([camera.image(frame) for camera in cameras], cameras[0].colours))


def frames(
    plays: Recordings,
    look: Look | None = None,
    titles: Sequence[str] | None = None,
    *,
    every: int = 1,
    hold: float = 1.0,
) -> Iterator[Frame]:
    """Draw all frames of one play, or of several side by side.

    Args:
        plays: one or more recordings of one frame rate; a shorter one waits at its last frame.
        look: how frames look.
        titles: one for each play; by default the names of the scenes.
        every: physics steps between two frames.
        hold: s, how long the last frame is shown.

    Returns:
        An iterator of (H, W, 3) uint8, the same size for all; each is drawn when it is asked for.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    numbers, cameras = frame_numbers(plays, every=every, hold=hold), _cameras(plays, look, titles)
    # Not a generator itself, which would check its arguments at the first frame.
    return (np.asarray(side_by_side([camera.image(k) for camera in cameras], cameras[0].colours)) for k in numbers)


def frame_numbers(plays: Recordings, *, every: int = 1, hold: float = 1.0) -> list[int]:
    """Return the physics step that each frame of a film shows; arguments and errors are those of `frames`."""
    check_whole("every", every, 1, MAX_FRAME)
    check_least("hold", hold, 0, MAX_SECONDS, "seconds")
    recordings = check_recordings(plays)
    steps = max(recording.steps for recording in recordings)
    return [*range(0, steps, every), steps, *[steps] * round(hold * recordings[0].fps / every)]


def check_recordings(plays: Recordings) -> list[Recording]:
    """Return plays as a list; ValueError in one line unless they are recordings of one frame rate."""
    if not isinstance(plays, Recording) and not is_list(plays):
        raise ValueError(f"plays: expected one or more recordings, got {show(plays)}")
    recordings = [plays] if isinstance(plays, Recording) else list(plays)
    for recording in recordings:
        check_instance("plays", recording, Recording, "recordings")
    rates = sorted({recording.fps for recording in recordings})
    if len(rates) != 1:
        raise ValueError(f"plays: expected at least one, all at one frame rate, got {len(recordings)} at {rates}")
    return recordings


def _cameras(plays: Recordings, look: Look | None, titles: Sequence[str] | None) -> list[Camera]:
    """Return a camera for each play."""
    recordings = check_recordings(plays)
    if look is not None:
        check_instance("look", look, Look, "a Look")
    if titles is not None and (not is_list(titles) or not all(isinstance(title, str) for title in titles)):
        raise ValueError(f"titles: expected a text for each play, got {show(titles)}")
    names = [None] * len(recordings) if titles is None else list(titles)
    if len(names) != len(recordings):
        raise ValueError(f"titles: expected {len(recordings)}, got {len(names)}")
    return [Camera(recording, look, name) for recording, name in zip(recordings, names, strict=True)]


def side_by_side(images: Sequence[Image.Image], colours: Theme) -> Image.Image:
    """Join pictures of the same height side by side."""
    if len(images) == 1:
        return images[0]
    width = sum(image.width for image in images) + GAP * (len(images) - 1)
    whole = Image.new("RGB", (width, images[0].height), blend(colours.text, colours.background, 0.25))
    x = 0
    for image in images:
        whole.paste(image, (x, 0))
        x += image.width + GAP
    return whole
