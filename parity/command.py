"""What the commands of `parity` and `benchmarks` share: checks of options, consoles, progress bars, how they end."""

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from iphyre_jax.checks import check_whole
from iphyre_jax.files import check_writable
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import topology_of

REPORT_WIDTH = 130  # columns
Arguments = TypeVar("Arguments")
_MOST = {"resets": 1000}  # the reference fills its space so often


def require_at_least(options: object, **least: int) -> None:
    """Check integer options.

    Raises:
        ValueError: an option is below its least value or above `_MOST`; the message names it.
    """
    for name, value in least.items():
        check_whole(f"--{name}", getattr(options, name), value, _MOST.get(name))


def require_once(name: str, values: Sequence[str] | Sequence[int], what: str = "value") -> None:
    """Check that no value of an option is there twice; ValueError in one line."""
    if len(set(values)) < len(values):
        raise ValueError(f"{name}: expected each {what} once, got {' '.join(map(str, values))}")


def require_rates(fps: Sequence[int], duration: float) -> None:
    """Check the rates of a comparison and the seconds of a play.

    Raises:
        ValueError: there is no rate, or a play has no whole number of steps; one line.
    """
    if not fps:
        raise ValueError("--fps: expected at least one value")
    if len(set(fps)) < len(fps):
        raise ValueError(f"--fps: expected each rate once, got {list(fps)}")
    for rate in fps:
        steps = duration * rate
        if not (1 <= steps < math.inf and abs(steps - round(steps)) <= 1e-6 * steps):
            raise ValueError(f"--duration: expected a whole number of steps at {rate} fps, got {duration} s")


def require_steps(scene: Scene, fps: Sequence[int], duration: float) -> None:
    """Check that a scene can make the steps of a play; ValueError in one line."""
    most, steps = topology_of(scene).max_steps, round(duration * max(fps))
    if steps > most:
        raise ValueError(f"--duration: expected at most {most} steps for the scene {scene.name}, got {steps}")


def require_output(folder: Path, name: str) -> None:
    """Make the folder of a report, before anything is played.

    Raises:
        ValueError: the name cannot begin the names of files; one line.
        OSError: the folder cannot be made.
    """
    if not name or name in (".", "..") or Path(name).name != name:
        raise ValueError(f"--name: expected how names of files begin, got {name!r}")
    folder.mkdir(parents=True, exist_ok=True)
    check_writable(folder, "--out")


def options_as_json(options: object) -> dict[str, Any]:
    """Options by name, as JSON takes them."""
    return {name: _plain(value) for name, value in vars(options).items()}


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return [_plain(inner) for inner in value]
    return str(value) if isinstance(value, Path) else value


def report_console() -> Console:
    """A console as wide as the terminal, or `REPORT_WIDTH` columns wide if the output goes elsewhere."""
    return Console(width=None if sys.stdout.isatty() else REPORT_WIDTH)


def progress_bar(console: Console) -> Progress:
    """A bar that shows what runs, how many pieces are done, and the time."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
    )


def run(main: Callable[[Arguments], None], kind: type[Arguments]) -> int:
    """Parse the command line and run a command; return 0, 2 for an error of one line, 130 if it was interrupted."""
    try:
        main(tyro.cli(kind))
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0
