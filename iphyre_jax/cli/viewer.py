"""`iphyre-jax render`, `replay`, `play`: films and pages. Needs the extra `train`, films and pictures also `viewer`."""

from __future__ import annotations

import secrets
import webbrowser
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from iphyre_jax.plans import Rule, plan_to_steps
from iphyre_jax.scenes import GAMES, SPLITS, Scene, load_scene, read_scene
from iphyre_jax.scenes.errors import show
from iphyre_jax.scenes.limits import MAX_NAME
from iphyre_jax.viewer.figures import figures_of, split_of
from iphyre_jax.viewer.load_plays import BEST, load_plays
from iphyre_jax.viewer.page import write_replay
from iphyre_jax.viewer.play.api import FPS, Api
from iphyre_jax.viewer.play.server import PlayServer
from iphyre_jax.viewer.play.session import ATTEMPTS, Session
from iphyre_jax.viewer.plays import is_name
from iphyre_jax.viewer.recording import Recording, record

if TYPE_CHECKING:
    from iphyre_jax.viewer.frames import Look

BESIDE = 4  # plays side by side at most
NEVER_WORDS = ("never", "-")

Out = Annotated[Path, tyro.conf.arg(aliases=["-o"])]


@dataclass(frozen=True)
class Render:
    """Render a play to a picture or film, plays side by side, or a contact sheet."""

    what: tyro.conf.Positional[str]
    """A game's name or a scene file, to be played under --plan; a split or "all", for a sheet of start scenes; a file
    of plays, a run folder or "best" (the best plans known), for a sheet of how they end, or with --game for its plays
    side by side."""
    out: Out
    """The file: .png, .gif or .mp4."""
    plan: tuple[str, ...] = ()
    """Seconds at which each eliminable block goes, in list order; "never" or "-" for one that stays."""
    game: str | None = None
    """Of a file of plays only those of this scene, side by side."""
    split: str | None = None
    """Of a file of plays only those of games of this split."""
    fps: int = 60
    """Physics steps a second."""
    rule: Rule = "simulate"
    """How seconds become steps, as for `iphyre-jax simulate`."""
    resets: int = 1
    """Number of the reset of a reused space."""
    dtype: Literal["float64", "float32"] = "float64"
    """Of the physics."""
    theme: Literal["modern", "dark", "official"] = "modern"
    """Colours."""
    size: int | None = None
    """Side of one picture, px; 600, or 150 on a sheet."""
    trails: bool = False
    """Show where the balls have been."""
    captions: bool = True
    """Show title, time and outcome above the picture."""
    fade: float = 0.4
    """Seconds in which a removed block fades."""
    frame: int | None = None
    """The frame that a PNG shows, counted from the end if negative; the last, or the first of start scenes."""
    columns: int = 8
    """Pictures in a row of a sheet."""
    hold: float = 1.0
    """Seconds that a film shows the end."""


@dataclass(frozen=True)
class Replay:
    """Write a page that plays any number of plays, one HTML file without network."""

    sources: tyro.conf.Positional[tuple[str, ...]]
    """Files of plays (JSON lines), run folders, or "best" for the best plans known."""
    out: Out = Path("replay.html")
    """The page."""
    games: tuple[str, ...] = ()
    """Only plays of these scenes."""
    title: str = "I-PHYRE replay"
    """Of the page."""


@dataclass(frozen=True)
class PlayPage:
    """Serve a page on this machine on which a person plays the games and draws scenes."""

    attempts: Path = Path("attempts.jsonl")
    """File of plays that each attempt is added to."""
    agents: tuple[str, ...] = ()
    """Files of plays and run folders to compare with."""
    scenes: tuple[Path, ...] = ()
    """Scene files to play beside the games of the package."""
    name: str = "you"
    """Of the person, as it stands in the file."""
    port: int = 0
    """0 for any that is free."""
    open: bool = False
    """Open the page in the browser."""


def render(command: Render, console: Console) -> None:
    """`iphyre-jax render`."""
    from iphyre_jax.viewer.films import save, save_picture
    from iphyre_jax.viewer.sheets import contact_sheet, start_of

    what = command.what
    starts = GAMES if what == "all" else SPLITS.get(what)
    if starts is not None:
        plays = [start_of(load_scene(game)) for game in starts]
        save_picture(
            command.out, contact_sheet(plays, columns=command.columns, frame=0, look=_frame_look(command, 150))
        )
    elif what == BEST or what.endswith(".jsonl") or Path(what).is_dir():
        chosen = [play for play in load_plays(what) if command.game in (None, play.scene.name)]
        chosen = [play for play in chosen if command.split in (None, split_of(play.scene.name))]
        if not chosen:
            asked = f"{command.game or 'any'} of {command.split or 'any split'}"
            raise ValueError(f"game: expected one that {what} has plays of, got {asked}")
        frame = -1 if command.frame is None else command.frame
        if command.game is None:
            sheet = contact_sheet(
                [play.record() for play in chosen], columns=command.columns, frame=frame, look=_frame_look(command, 150)
            )
            save_picture(command.out, sheet)
        else:
            side, titles = [play.record() for play in chosen[:BESIDE]], [play.agent for play in chosen[:BESIDE]]
            save(command.out, side, _frame_look(command, 600), titles, frame=frame, hold=command.hold)
    else:
        play = _record_plan(command, load_scene(what))
        frame = -1 if command.frame is None else command.frame
        save(command.out, play, _frame_look(command, 600), frame=frame, hold=command.hold)
        state = "solved" if play.success else "not solved"
        console.print(
            f"{play.scene.name}: {state} after {play.steps} steps, reward {play.reward:.4f}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    console.print(
        f"{command.out}: {command.out.stat().st_size / 1000:.0f} kB", markup=False, highlight=False, soft_wrap=True
    )


def _frame_look(command: Render, size: int) -> Look:
    """Return how the frames are to look."""
    from iphyre_jax.viewer.frames import Look

    return Look(
        theme=command.theme,
        size=command.size or size,
        captions=command.captions,
        trails=command.trails,
        fade=command.fade,
    )


def _record_plan(command: Render, scene: Scene) -> Recording:
    """Return the play of a scene under the command's plan."""
    times = seconds_of(command.plan, scene)
    steps = plan_to_steps(times, command.fps, command.rule)[0]
    return record(scene, steps, fps=command.fps, dtype=command.dtype, resets=command.resets)


def seconds_of(words: Sequence[str], scene: Scene) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return a plan in words as seconds, (1, S), one for each eliminable block, NaN for one that stays.

    Raises:
        ValueError: one line; a word is no time, or there are too many.
    """
    blocks = len(scene.eliminable_blocks)
    if len(words) > blocks:
        raise ValueError(
            f"plan: expected at most {blocks} times, one for each eliminable block of {scene.name}, got {len(words)}"
        )
    seconds = np.full((1, blocks), np.nan)
    for k, word in enumerate(words):
        try:
            seconds[0, k] = np.nan if word in NEVER_WORDS else float(word)
        except ValueError:
            raise ValueError(f"plan: expected seconds or never, got {word!r}") from None
    return seconds


def replay(command: Replay, console: Console) -> None:
    """`iphyre-jax replay`."""
    if not command.sources:
        raise ValueError("sources: expected at least one file of plays, run folder, or best")
    plays = [play for source in command.sources for play in load_plays(source)]
    chosen = [play for play in plays if not command.games or play.scene.name in command.games]
    if not chosen:
        raise ValueError(f"games: expected scenes that the sources have plays of, got {', '.join(command.games)}")
    with console.status(f"playing {len(chosen)} plans"):
        changed = write_replay(command.out, chosen, title=command.title)
    for line in changed:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    size = command.out.stat().st_size / 1000
    console.print(f"{command.out}: {len(chosen)} plays, {size:.0f} kB", markup=False, highlight=False, soft_wrap=True)


def play(command: PlayPage, console: Console) -> None:
    """`iphyre-jax play`."""
    agents = [entry for source in command.agents for entry in load_plays(source)]
    scenes = [read_scene(path) for path in command.scenes]
    if not 0 <= command.port < 65536:
        raise ValueError(f"port: expected 0 to 65535, got {command.port}")
    if not is_name(command.name):
        raise ValueError(f"name: expected a text of 1 to {MAX_NAME} printable characters, got {show(command.name)}")
    if not command.attempts.parent.is_dir():
        raise ValueError(f"{command.attempts}: expected a file in a folder that exists")
    session = Session(command.attempts, command.name)
    with PlayServer(Api(session, agents, scenes), secrets.token_urlsafe(24), command.port) as server:
        console.print(f"Play at {server.address}", markup=False, highlight=False, soft_wrap=True)
        console.print(
            f"Attempts are added to {command.attempts}; Ctrl-C ends.", markup=False, highlight=False, soft_wrap=True
        )
        if command.open:
            webbrowser.open(server.address)
        server.serve_forever()


def evaluate_plays(path: Path, console: Console) -> None:
    """`iphyre-jax evaluate` of a file of plays: play all again, and print what each agent attained in each game.

    Tables never mix frame rates. The best of the first five attempts stands beside the people of the paper.
    """
    groups: dict[tuple[int, str], dict[Scene, list[float]]] = defaultdict(lambda: defaultdict(list))
    plays = load_plays(path)
    for entry in plays:
        recording = entry.record()
        groups[entry.fps, entry.agent][entry.scene].append(recording.reward)
        if difference := entry.difference(recording):
            console.print(
                f"{entry.agent}, {entry.scene.name}: the file says {difference}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
    for (fps, agent), games in sorted(groups.items(), key=lambda group: group[0]):
        console.print(f"{agent} at {fps} steps a second", markup=False, highlight=False, soft_wrap=True)
        console.print(_score_table(games, fps))


def _score_table(games: dict[Scene, list[float]], fps: int) -> Table:
    """Return the attempts of one agent at one rate, by game."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column("game", no_wrap=True)
    for title in ("attempts", "solved", f"best of first {ATTEMPTS}", "people (paper)"):
        table.add_column(title, justify="right")
    best = []
    for scene, rewards in games.items():
        best.append(max(rewards[:ATTEMPTS]))
        known = split_of(scene.name) is not None and scene == load_scene(scene.name)
        human = figures_of(scene.name).get("human") if known and fps == FPS else None
        solved = sum(reward > 0 for reward in rewards)
        cells = (str(len(rewards)), str(solved), f"{best[-1]:.2f}", "" if human is None else f"{human:.2f}")
        table.add_row(Text(scene.name), *cells)
    table.add_row("mean", "", "", f"{np.mean(best):.2f}", "", style="bold")
    return table
