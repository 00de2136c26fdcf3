"""`iphyre-jax replay`, `play`, `score`: plays of files, and the play page. Needs the extra `train`."""

from __future__ import annotations

import secrets
import webbrowser
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from iphyre_jax.checks import show
from iphyre_jax.cli.console import option, warnings_in_one_line
from iphyre_jax.cli.signals import until_signal
from iphyre_jax.files import check_output
from iphyre_jax.paper import paper_rewards
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.scenes import Scene, read_scene
from iphyre_jax.scenes.library import is_game
from iphyre_jax.scenes.limits import MAX_NAME
from iphyre_jax.train.reports.printing import print_table, say
from iphyre_jax.viewer.load_plays import BEST, SOURCES, each_play, load_plays
from iphyre_jax.viewer.page import write_replay
from iphyre_jax.viewer.play.api import Api
from iphyre_jax.viewer.play.server import PlayServer
from iphyre_jax.viewer.play.session import ATTEMPTS, Session
from iphyre_jax.viewer.plays import is_name


@dataclass(frozen=True)
class Replay:
    """Write a web page that replays plays: one HTML file that needs no network."""

    sources: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        option(
            "SOURCE ...",
            "Files of plays (JSON lines), run folders, policies such as ppo-i, or best (the best known plans).",
            "",
        ),
    ]
    out: Annotated[Path, option("FILE", "The page to write.", aliases=("-o",))] = Path("replay.html")
    games: Annotated[tuple[str, ...], option("GAME ...", "Show only plays of these games.", "all games")] = ()
    title: Annotated[str, option("TEXT", "Title of the page.")] = "I-PHYRE replay"


@dataclass(frozen=True)
class PlayPage:
    """Play the games in the browser, draw scenes and compare attempts. The page is served on this machine only."""

    attempts: Annotated[Path, option("FILE", "File of plays to which each attempt is added.")] = Path("attempts.jsonl")
    agents: Annotated[
        tuple[str, ...],
        option(
            "SOURCE ...",
            "Files of plays, run folders, policies such as ppo-i to compare with, besides the best known plans.",
            "none",
        ),
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


def replay(command: Replay, console: Console) -> int:
    """`iphyre-jax replay`."""
    return until_signal(partial(_replay, command, console))


@warnings_in_one_line()
def _replay(command: Replay, console: Console) -> None:
    """Write the page."""
    if not command.sources:
        raise ValueError(f"sources: expected at least one: {SOURCES}")
    check_output("out", command.out, (".html", ".htm"))
    plays = (play for source in command.sources for play in each_play(source))
    chosen = [play for play in plays if not command.games or play.scene.name in command.games]
    without = sorted(set(command.games) - {play.scene.name for play in chosen})
    if without or not chosen:
        raise ValueError(f"games: expected games with plays in the sources, got {', '.join(without) or 'no plays'}")
    with console.status(f"playing {len(chosen)} plans"):
        changed = write_replay(command.out, chosen, title=command.title)
    for line in changed:
        say(console, line)
    say(console, f"{command.out}: {len(chosen)} plays, {command.out.stat().st_size / 1000:.0f} kB")


@warnings_in_one_line()
def play(command: PlayPage, console: Console) -> None:
    """`iphyre-jax play`."""
    agents = [entry for source in command.agents if source != BEST for entry in load_plays(source)]
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


@warnings_in_one_line()
def score(command: Score, console: Console) -> None:
    """`iphyre-jax score`: replay a file of plays and print each agent's rewards by game.

    Tables never mix frame rates, number types or resets. The best of the first five attempts is shown beside the mean
    of people in the paper.
    """
    groups: dict[tuple[int, str, int, str], dict[Scene, list[float]]] = defaultdict(lambda: defaultdict(list))
    for entry in each_play(command.plays):
        recording = entry.record()
        groups[entry.fps, entry.dtype, entry.resets, entry.agent][entry.scene].append(recording.reward)
        if difference := entry.difference(recording):
            say(console, f"{entry.agent}, {entry.scene.name}: the file says {difference}")
    for (fps, dtype, resets, agent), games in sorted(groups.items(), key=lambda group: group[0]):
        say(console, f"{agent} at {fps} steps a second, {dtype}, reset {resets}")
        print_table(console, _score_table(games, fps))


def _score_table(games: dict[Scene, list[float]], fps: int) -> Table:
    """Return a table of one agent's attempts at one frame rate, a row for each game."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column("game")
    for title in ("attempts", "solved", f"best of first {ATTEMPTS}", "people (paper)"):
        table.add_column(title, justify="right")
    best, names = [], [scene.name for scene in games]
    for place, (scene, rewards) in enumerate(games.items()):
        number = f" #{names[: place + 1].count(scene.name)}" if names.count(scene.name) > 1 else ""
        best.append(max(rewards[:ATTEMPTS]))
        human = paper_rewards(scene.name).get("human") if is_game(scene) and fps == PEOPLE_FPS else None
        solved = sum(reward > 0 for reward in rewards)
        cells = (str(len(rewards)), str(solved), f"{best[-1]:.2f}", "" if human is None else f"{human:.2f}")
        table.add_row(Text(scene.name + number), *cells)
    table.add_row("mean", "", "", f"{np.mean(best):.2f}", "", style="bold")
    return table
