"""`iphyre-jax render`, `replay`, `play`, `score`. Needs the extra `train`; films and pictures also need `viewer`."""

from __future__ import annotations

import secrets
import sys
import warnings
import webbrowser
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TextIO

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from iphyre_jax.checks import show
from iphyre_jax.cli.console import option, say
from iphyre_jax.plans import Rule, parse_plan, plan_to_steps
from iphyre_jax.scenes import GAMES, SPLITS, Scene, load_scene, read_scene
from iphyre_jax.scenes.limits import MAX_NAME
from iphyre_jax.viewer.figures import figures_of, split_of
from iphyre_jax.viewer.load_plays import BEST, each_play, load_plays
from iphyre_jax.viewer.page import write_replay
from iphyre_jax.viewer.play.api import FPS, Api
from iphyre_jax.viewer.play.server import PlayServer
from iphyre_jax.viewer.play.session import ATTEMPTS, Session
from iphyre_jax.viewer.plays import is_name
from iphyre_jax.viewer.recording import Recording, record

if TYPE_CHECKING:
    from iphyre_jax.viewer.frames import Look

BESIDE = 4  # plays side by side at most
SHEET_SIZE, PICTURE_SIZE = 150, 600  # px, side of one picture by default

Plan = Annotated[
    tuple[str, ...],
    option(
        "SECONDS ...",
        'When to remove each eliminable block, in the order of "iphyre-jax games": seconds, separated by spaces. '
        '"never" or "-" keeps a block. Blocks without a time stay.',
        "remove nothing",
    ),
]


@dataclass(frozen=True)
class Render:
    """Draw plays: one as a picture or film, some side by side, or many on one sheet."""

    what: Annotated[
        tyro.conf.Positional[str],
        option(
            "WHAT",
            "A game or a scene file: it is played under --plan. A split or all: a sheet of start positions. "
            "A file of plays, a run folder or best (the best known plans): a sheet of final positions, "
            "or with --game the plays of that game side by side.",
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
    frame: Annotated[
        int | None, option("FRAME", "The frame that a picture shows; -1 is the last.", "last; on a sheet of starts 0")
    ] = None
    columns: int = 8
    """Pictures in a row of a sheet."""
    hold: float = 1.0
    """Seconds that a film shows the last frame."""


@dataclass(frozen=True)
class Replay:
    """Write a web page that replays plays: one HTML file that needs no network."""

    sources: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        option("SOURCE ...", "Files of plays (JSON lines), run folders, or best (the best known plans).", ""),
    ]
    out: Annotated[Path, option("FILE", "The page to write.", aliases=("-o",))] = Path("replay.html")
    games: Annotated[tuple[str, ...], option("GAME ...", "Show only plays of these games.", "all games")] = ()
    title: Annotated[str, option("TEXT", "Title of the page.")] = "I-PHYRE replay"


@dataclass(frozen=True)
class PlayPage:
    """Play the games in the browser, draw scenes and compare attempts. The page is served on this machine only."""

    attempts: Annotated[Path, option("FILE", "File of plays to which each attempt is added.")] = Path("attempts.jsonl")
    agents: Annotated[
        tuple[str, ...], option("SOURCE ...", "Files of plays and run folders to compare with.", "the best known plans")
    ] = ()
    scenes: Annotated[tuple[Path, ...], option("FILE ...", "Scene files to play besides the games.", "none")] = ()
    name: Annotated[str, option("NAME", "Your name in the file of attempts.")] = "you"
    port: Annotated[int, option("PORT", "Port of the page.", "any free port")] = 0
    open: bool = False
    """Open the page in the browser."""


@dataclass(frozen=True)
class Score:
    """Replay a file of plays and print each agent's scores by game, beside those of people."""

    plays: Annotated[tyro.conf.Positional[Path], option("FILE", "The file of plays (JSON lines).")]


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print warnings, such as those about damaged files, like the errors of a command."""

    def show_warning(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        del filename, lineno, file, line
        print(f"iphyre-jax: {category.__name__}: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        yield


@_warnings_in_one_line()
def render(command: Render, console: Console) -> None:
    """`iphyre-jax render`."""
    from iphyre_jax.viewer.films import save, save_picture
    from iphyre_jax.viewer.sheets import contact_sheet, start_of

    what, frame = command.what, -1 if command.frame is None else command.frame
    starts = GAMES if what == "all" else SPLITS.get(what)
    if starts is not None:
        plays = [start_of(load_scene(game)) for game in starts]
        sheet = contact_sheet(plays, columns=command.columns, frame=0, look=_frame_look(command, SHEET_SIZE))
        save_picture(command.out, sheet)
    elif what == BEST or what.endswith(".jsonl") or Path(what).is_dir():
        chosen = [play for play in each_play(what) if command.game in (None, play.scene.name)]
        chosen = [play for play in chosen if command.split in (None, split_of(play.scene.name))]
        if not chosen:
            asked = f"{command.game or 'any'} of {command.split or 'any split'}"
            raise ValueError(f"game: expected a game with plays in {what}, got {asked}")
        if command.game is None:
            plays, look = [play.record() for play in chosen], _frame_look(command, SHEET_SIZE)
            save_picture(command.out, contact_sheet(plays, columns=command.columns, frame=frame, look=look))
        else:
            plays, titles = [play.record() for play in chosen[:BESIDE]], [play.agent for play in chosen[:BESIDE]]
            save(command.out, plays, _frame_look(command, PICTURE_SIZE), titles, frame=frame, hold=command.hold)
    else:
        play = _record_plan(command, load_scene(what))
        save(command.out, play, _frame_look(command, PICTURE_SIZE), frame=frame, hold=command.hold)
        state = "solved" if play.success else "not solved"
        say(console, f"{play.scene.name}: {state} after {play.steps} steps, reward {play.reward:.4f}")
    say(console, f"{command.out}: {command.out.stat().st_size / 1000:.0f} kB")


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


@_warnings_in_one_line()
def replay(command: Replay, console: Console) -> None:
    """`iphyre-jax replay`."""
    if not command.sources:
        raise ValueError("sources: expected at least one file of plays, run folder, or best")
    plays = (play for source in command.sources for play in each_play(source))
    chosen = [play for play in plays if not command.games or play.scene.name in command.games]
    if not chosen:
        raise ValueError(f"games: expected games with plays in the sources, got {', '.join(command.games)}")
    with console.status(f"playing {len(chosen)} plans"):
        changed = write_replay(command.out, chosen, title=command.title)
    for line in changed:
        say(console, line)
    say(console, f"{command.out}: {len(chosen)} plays, {command.out.stat().st_size / 1000:.0f} kB")


@_warnings_in_one_line()
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
    api = Api(Session(command.attempts, command.name), agents, scenes)
    try:
        server = PlayServer(api, secrets.token_urlsafe(24), command.port)
    except OSError as error:
        raise OSError(f"port: expected a free port, got {command.port}: {error.strerror}") from None
    api.simulator.warm_up()
    with server:
        say(console, f"Play at {server.address}")
        say(console, f"Attempts are added to {command.attempts}. Ctrl-C ends the game.")
        if command.open:
            webbrowser.open(server.address)
        server.serve_forever()


@_warnings_in_one_line()
def score(command: Score, console: Console) -> None:
    """`iphyre-jax score`: replay a file of plays and print each agent's rewards by game.

    Tables never mix frame rates. The best of the first five attempts is shown beside the mean of people in the paper.
    """
    groups: dict[tuple[int, str], dict[Scene, list[float]]] = defaultdict(lambda: defaultdict(list))
    for entry in each_play(command.plays):
        recording = entry.record()
        groups[entry.fps, entry.agent][entry.scene].append(recording.reward)
        if difference := entry.difference(recording):
            say(console, f"{entry.agent}, {entry.scene.name}: the file says {difference}")
    for (fps, agent), games in sorted(groups.items(), key=lambda group: group[0]):
        say(console, f"{agent} at {fps} steps a second")
        console.print(_score_table(games, fps))


def _score_table(games: dict[Scene, list[float]], fps: int) -> Table:
    """Return a table of one agent's attempts at one frame rate, a row for each game."""
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
