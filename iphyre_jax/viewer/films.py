"""Frames to files: PNG, GIF and MP4. Films keep the size of their frames."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import IO, Final, cast

import numpy as np
from PIL import Image

from iphyre_jax.scenes.errors import one_line
from iphyre_jax.viewer.frames import Frame, Look, Recordings, frames, still
from iphyre_jax.viewer.recording import Recording

SUFFIXES: Final = (".png", ".gif", ".mp4")
GIF_TICK = 100  # a GIF's times are hundredths of a second
GIF_RATE = 25  # frames a second that viewers show without slowing down
GIF_COLOURS = 64


def save(
    path: str | os.PathLike[str],
    plays: Recordings,
    look: Look | None = None,
    titles: Sequence[str] | None = None,
    *,
    frame: int = -1,
    hold: float = 1.0,
) -> None:
    """Save a picture or a film of one play, or of several side by side; a file that stands there is replaced whole.

    Args:
        path: ends in .png, .gif or .mp4; its folder must exist.
        plays: of one frame rate.
        look: how frames look.
        titles: one for each play; by default the scenes' names.
        frame: which one a PNG shows, counted from the end if it is negative.
        hold: s that a film shows the end.

    Raises:
        ValueError: one line that names the argument and what was expected.
        OSError: the file cannot be written.
        ModuleNotFoundError: MP4 needs imageio_ffmpeg, of the extra `viewer`.
    """
    target = _target(path, SUFFIXES)
    fps = plays.fps if isinstance(plays, Recording) else plays[0].fps if plays else 1
    with _part(target) as part:
        if target.suffix.lower() == ".png":
            Image.fromarray(still(plays, look, titles, frame=frame)).save(part, optimize=True)
        elif target.suffix.lower() == ".gif":
            every = _gif_step(fps)
            _write_gif(part, frames(plays, look, titles, every=every, hold=hold), fps / every)
        else:
            write_mp4(part, frames(plays, look, titles, hold=hold), fps)


def save_picture(path: str | os.PathLike[str], frame: Frame) -> None:
    """Save one picture as PNG; a file that stands there is replaced whole.

    Args:
        path: ends in .png; its folder must exist.
        frame: (H, W, 3) uint8.

    Raises:
        ValueError: another ending, or no such folder.
        OSError: the file cannot be written.
    """
    with _part(_target(path, SUFFIXES[:1])) as part:
        Image.fromarray(frame).quantize(256, dither=Image.Dither.NONE).save(part, optimize=True)


def _target(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Path:
    """Return the file to write, or raise a one-line ValueError."""
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        raise ValueError(f"{target}: expected a name that ends in {', '.join(suffixes)}")
    if not target.parent.is_dir():
        raise ValueError(f"{target}: expected a file in a folder that exists")
    return target


@contextmanager
def _part(target: Path) -> Iterator[Path]:
    """Give the name of a file beside the target, which takes its place when all has gone well."""
    part = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix.lower()}")
    try:
        yield part
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _gif_step(fps: int) -> int:
    """Return how many physics steps a GIF's frame stands for."""
    return max(1, -(-fps // GIF_RATE))


def _write_gif(path: Path, pictures: Iterable[Frame], rate: float) -> None:
    """Write a GIF that repeats; each frame lasts whole ticks, and the sum of all keeps to time."""
    images = [Image.fromarray(one) for one in pictures]
    sample = Image.new("RGB", (images[0].width, images[0].height * 3))
    for place, k in enumerate((0, len(images) // 2, len(images) - 1)):
        sample.paste(images[k], (0, place * images[0].height))
    palette = sample.quantize(GIF_COLOURS, dither=Image.Dither.NONE)
    indexed = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    ends = [round(GIF_TICK * (k + 1) / rate) for k in range(len(images))]
    lasts = [1000 // GIF_TICK * (end - start) for start, end in zip([0, *ends], ends, strict=False)]
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=lasts, loop=0, optimize=False)


def write_mp4(path: Path, pictures: Iterable[Frame], fps: float) -> None:
    """Write an H.264 film of the size of its frames, which must be even, as the format's colours are shared by fours.

    Raises:
        ValueError: the size is odd.
        OSError: the encoder failed.
    """
    import imageio_ffmpeg

    stream: Iterator[Frame] = iter(pictures)
    first = next(stream)
    height, width = first.shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"size: expected even numbers of px for a film in MP4, got {width} x {height}")
    shape = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    coding = ["-c:v", "libx264", "-preset", "veryfast", "-tune", "animation", "-crf", "20", "-pix_fmt", "yuv420p"]
    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:  # a platform without a bundled one
        raise OSError(f"{path}: films in MP4 need ffmpeg, which imageio_ffmpeg does not find: {error}") from None
    command = [program, "-y", "-loglevel", "error", *shape, *coding, str(path)]
    encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)  # noqa: S603 - our own arguments
    try:
        for one in chain([first], stream):
            cast(IO[bytes], encoder.stdin).write(np.ascontiguousarray(one).tobytes())
        _, message = encoder.communicate()
    except BrokenPipeError:
        _, message = encoder.communicate()
    finally:
        encoder.kill()
        encoder.wait()
    if encoder.returncode:
        reason = one_line(message.decode(errors="replace").strip())[:200]
        raise OSError(f"{path}: the film could not be encoded: {reason}")
