"""`iphyre-jax render`: plays as pictures, films and sheets. Needs the extras `train` and `viewer`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro
from rich.console import Console

from iphyre_jax.checks import check_least, check_option, show
from iphyre_jax.cli.console import Plan, option, refuse_unread, warnings_in_one_line
from iphyre_jax.cli.signals import until_signal
from iphyre_jax.files import check_output
from iphyre_jax.plans import Rule, parse_plan, plan_to_steps
from iphyre_jax.scenes import SPLITS, Scene, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, GAME_LISTS, SPLIT_OF, is_game
from iphyre_jax.train.reports.printing import say
from iphyre_jax.viewer.load_plays import BEST, each_play, is_policy
from iphyre_jax.viewer.plays import holds_plays
from iphyre_jax.viewer.recording import Recording, record

if TYPE_CHECKING:
    from iphyre_jax.viewer.frames import Look

BESIDE = 4  # plays side by side at most
SHEET_SIZE, PICTURE_SIZE = 150, 600  # px, side of one picture by default


@dataclass(frozen=True)
class Render:
    """Draw plays: one as a picture or film, some side by side, or many on one sheet."""

    what: Annotated[
        tyro.conf.Positional[str],
        option(
            "WHAT",
            "A game or a scene file: it is played under --plan. A split or all: a sheet of start positions. "
            "A file of plays, a run folder, a policy such as ppo-i, or best (the best known plans): a sheet of final "
            "positions, or with --game the plays of that game side by side.",
        ),
    ]
    out: Annotated[Path, option("FILE", "The file to write: .png, .gif or .mp4.", aliases=("-o",))]
    plan: Plan = ()
    game: Annotated[str | None, option("GAME", "Draw only plays of this game, side by side.", "all games")] = None
    split: Annotated[str | None, option("SPLIT", "Draw only plays of games of this split.", "all splits")] = None
    fps: int = 60
    """Physics steps a second."""
    rule: Rule = "simulate"
    """How seconds become steps; see "iphyre-jax simulate --help"."""
    resets: int = 1
    """Number of the reset in a reused physics space; 1 is a fresh space."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of the physics."""
    theme: Literal["modern", "dark", "official"] = "modern"
    """Colours."""
    size: Annotated[int | None, option("PX", "Side of one picture.", f"{PICTURE_SIZE}, on a sheet {SHEET_SIZE}")] = None
    trails: bool = False
    """Show the paths of the balls."""
    captions: bool = True
    """Show title, time and result above the picture."""
    fade: float = 0.4
    """Seconds in which a removed block fades."""
    frame: Annotated[int | None, option("FRAME", "The frame that a picture shows; -1 is the last.", "last")] = None
    columns: int = 8
    """Pictures in a row of a sheet."""
    hold: float = 1.0
    """Seconds that a film shows the last frame."""


DRAWN: Final = ("what", "out", "theme", "size", "trails", "captions", "fade")  # options that each picture reads
READ_FOR: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "sheet": ("columns",),  # start positions
        "plays": ("columns", "frame", "split"),
        "game": ("frame", "hold", "game", "split"),  # its plays side by side
        "scene": ("frame", "hold", "plan", "fps", "rule", "resets", "dtype"),
    }
)


def run(command: Render, console: Console) -> int:
    """`iphyre-jax render`."""
    return until_signal(partial(_render, command, console))


@warnings_in_one_line()
def _render(command: Render, console: Console) -> None:
    """Draw what the command names."""
    from iphyre_jax.viewer.films import SUFFIXES, save, save_picture
    from iphyre_jax.viewer.frames import MAX_SECONDS
    from iphyre_jax.viewer.sheets import contact_sheet, start_of

    if command.split is not None:
        check_option("split", command.split, tuple(SPLITS))
    what, frame = command.what, -1 if command.frame is None else command.frame
    starts = GAME_LISTS.get(what)
    of_plays = what == BEST or what.endswith((".jsonl", ".npz")) or _has_plays(what)
    shown = "sheet" if starts is not None else "scene" if not of_plays else "plays" if command.game is None else "game"
    is_sheet = shown in ("sheet", "plays")
    check_output("out", command.out, (".png",) if is_sheet else SUFFIXES)
    unread = "hold" if command.out.suffix.lower() == ".png" else "frame"
    read = [name for name in (*DRAWN, *READ_FOR[shown]) if name != unread]
    refuse_unread(command, read, f"for {what}{' with --game' if shown == 'game' else ''} in {command.out.name}")
    look = _frame_look(command, SHEET_SIZE if is_sheet else PICTURE_SIZE)
    check_least("hold", command.hold, 0, MAX_SECONDS, "seconds")
    if starts is not None:
        plays = [start_of(load_scene(game)) for game in starts]
        sheet = contact_sheet(plays, columns=command.columns, frame=0, look=look)
        save_picture(command.out, sheet)
    elif of_plays:
        chosen = [play for play in each_play(what) if command.game in (None, play.scene.name)]
        chosen = [play for play in chosen if command.split in (None, _split_of(play.scene))]
        if not chosen:
            asked = f"{command.game or 'any'} of {command.split or 'any split'}"
            raise ValueError(f"game: expected a game with plays in {what}, got {asked}")
        if command.game is None:
            plays = [play.record() for play in chosen]
            save_picture(command.out, contact_sheet(plays, columns=command.columns, frame=frame, look=look))
        else:
            if len({play.scene for play in chosen}) > 1:
                raise ValueError(f"game: expected plays of one scene, got other scenes named {show(command.game)} too")
            if len(chosen) > BESIDE:
                say(console, f"{what}: the first {BESIDE} of {len(chosen)} plays of {command.game}")
            plays, titles = [play.record() for play in chosen[:BESIDE]], [play.agent for play in chosen[:BESIDE]]
            titles[0] = f"{command.game}: {titles[0]}"
            save(command.out, plays, look, titles, frame=frame, hold=command.hold)
    else:
        play = _record_plan(command, load_scene(what))
        save(command.out, play, look, frame=frame, hold=command.hold)
        state = "solved" if play.success else "not solved"
        say(console, f"{play.scene.name}: {state} after {play.steps} steps, reward {play.reward:.4f}")
    say(console, f"{command.out}: {command.out.stat().st_size / 1000:.0f} kB")


def _split_of(scene: Scene) -> str | None:
    """The split of a scene; None unless it is a game of the package, whatever its name."""
    return SPLIT_OF[scene.name] if is_game(scene) else None


def _has_plays(what: str) -> bool:
    """Return whether this is a folder, a file of plays of whatever name, or a policy; the names of games come first."""
    path = Path(what)
    if what in ("", *ALL_GAMES):
        return False
    return path.is_dir() or (holds_plays(path) if path.is_file() else is_policy(what))


def _frame_look(command: Render, size: int) -> Look:
    """Return the look of the frames; `size` is used if the command sets none."""
    from iphyre_jax.viewer.frames import Look

    return Look(
        command.theme, size if command.size is None else command.size, command.captions, command.trails, command.fade
    )


def _record_plan(command: Render, scene: Scene) -> Recording:
    """Play a scene under the command's plan."""
    steps = plan_to_steps(parse_plan(command.plan, scene), command.fps, command.rule)[0]
    return record(scene, steps, fps=command.fps, dtype=command.dtype, resets=command.resets)
