"""Write frames to files: PNG, GIF and MP4. Films have the size of their frames."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import IO, Final, cast

import numpy as np

from iphyre_jax.checks import missing_extra, one_line
from iphyre_jax.files import check_output, replacing
from iphyre_jax.memory import check_memory
from iphyre_jax.viewer.frames import Frame, Look, Recordings, check_recordings, frame_numbers, frames, still

try:
    from PIL import Image
except ModuleNotFoundError as error:
    raise missing_extra(__name__, "viewer", error.name) from None

SUFFIXES: Final = (".png", ".gif", ".mp4")
GIF_TICK = 100  # a GIF counts time in hundredths of a second
GIF_RATE = 25  # frames a second; viewers slow down faster GIFs
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
    """Save a picture or film of one play, or of several side by side. An existing file is replaced as a whole.

    Args:
        path: the file, .png, .gif or .mp4; its folder must exist.
        plays: one or more recordings of one frame rate.
        look: how frames look.
        titles: one for each play; by default the names of the scenes.
        frame: the frame that a PNG shows; negative numbers count from the end.
        hold: s, how long a film shows the last frame.

    Raises:
        ValueError: one line that names the argument and what was expected.
        OSError: the file cannot be written.
        ModuleNotFoundError: MP4 needs imageio_ffmpeg, of the extra `viewer`.
    """
    target = Path(path)
    check_output("path", target, SUFFIXES)
    fps = check_recordings(plays)[0].fps
    with replacing(target) as part:
        if target.suffix.lower() == ".png":
            Image.fromarray(still(plays, look, titles, frame=frame)).save(part, optimize=True)
        elif target.suffix.lower() == ".gif":
            every = _gif_step(fps)
            numbers = frame_numbers(plays, every=every, hold=hold)
            samples = [still(plays, look, titles, frame=numbers[k]) for k in (0, len(numbers) // 2, -1)]
            film = frames(plays, look, titles, every=every, hold=hold)
            _write_gif(part, film, samples, len(numbers), fps / every)
        else:
            write_mp4(part, frames(plays, look, titles, hold=hold), fps)


def save_picture(path: str | os.PathLike[str], frame: Frame) -> None:
    """Save one picture as PNG. An existing file is replaced as a whole.

    Args:
        path: the file, .png; its folder must exist.
        frame: (H, W, 3) uint8.

    Raises:
        ValueError: the name has another ending, or the folder does not exist.
        OSError: the file cannot be written.
    """
    target = Path(path)
    check_output("path", target)
    with replacing(target) as part:
        Image.fromarray(frame).quantize(256, dither=Image.Dither.NONE).save(part, optimize=True)


def _gif_step(fps: int) -> int:
    """Return the number of physics steps between two frames of a GIF."""
    return max(1, -(-fps // GIF_RATE))


def _write_gif(path: Path, pictures: Iterable[Frame], samples: Sequence[Frame], count: int, rate: float) -> None:
    """Write a looping GIF. Each frame lasts whole ticks; rounding errors do not add up.

    Args:
        path: the file.
        pictures: its frames.
        samples: those of its frames whose colours it has.
        count: the number of frames.
        rate: frames a second.

    Raises:
        ValueError: Pillow keeps a byte for each pixel until the end, and so much memory is not free.
    """
    check_memory("size", count * samples[0][..., 0].size, "make a smaller film, or .mp4")
    palette = Image.fromarray(np.concatenate(samples)).quantize(GIF_COLOURS, dither=Image.Dither.NONE)
    indexed = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    ends = [round(GIF_TICK * (k + 1) / rate) for k in range(count)]
    lasts = [1000 // GIF_TICK * (end - start) for start, end in zip([0, *ends], ends, strict=False)]
    next(indexed).save(path, save_all=True, append_images=indexed, duration=lasts, loop=0, optimize=False)


def write_mp4(path: Path, pictures: Iterable[Frame], fps: float) -> None:
    """Write an H.264 film. Width and height must be even, because four pixels share one colour in this format.

    Raises:
        ValueError: width or height is odd.
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
    except RuntimeError as error:  # no ffmpeg is bundled for this platform
        raise OSError(f"{path}: MP4 needs ffmpeg, and imageio_ffmpeg cannot find it: {error}") from None
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
        raise OSError(f"{path}: ffmpeg could not encode the film: {reason}")
