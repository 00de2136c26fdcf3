"""Plays of people and other players: the official player lines, our files of plays, and data sets of either.

{"player": "ann", "game": "hole", "episode": 0, "actions": [[x, y, t], ...], "reward": 975.65}

A line is an attempt: the clicks that removed a block, each with the official clock at the step before which it did.
Attempt e of a game is played in the reset e + 1 of one space, at 60 steps a second.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.checks import one_line, show
from iphyre_jax.compat.objects import block_at
from iphyre_jax.data.collection import build
from iphyre_jax.data.dataset import Dataset, scene_entry
from iphyre_jax.data.journal import Journal
from iphyre_jax.data.labels import PlayProtocol, label_plans
from iphyre_jax.data.recipe import MOST_FPS, Recipe
from iphyre_jax.files import parse_json, replace_text
from iphyre_jax.plans import official_clock, steps_to_times
from iphyre_jax.rules import NEVER, PEOPLE_FPS, TIME_LIMIT
from iphyre_jax.scenes import Scene, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, hint, is_game
from iphyre_jax.viewer.line_files import read_lines
from iphyre_jax.viewer.plays import Play, is_name

FIELDS: Final = ("player", "game", "episode", "actions", "reward")
MAX_LINE: Final = 100_000  # bytes
MAX_EPISODE: Final = 999  # files of plays know resets up to 1000
NOBODY: Final = "nobody"  # the official default is an empty name, which our files do not allow


@dataclass(frozen=True)
class PlayerLine:
    """An attempt of a player.

    Attributes:
        play: the attempt as our files of plays hold it.
        episode: its number among the player's attempts at this game, from 0.
        reward: what the line states; None if it is one of ours.
    """

    play: Play
    episode: int
    reward: float | None = None


def read_player_lines(path: str | os.PathLike[str]) -> list[PlayerLine]:
    """Read the lines that the official `collect_while_play` writes.

    Raises:
        OSError: the file cannot be read.
        ValueError: a line is wrong; one line that names file, line and field.
    """
    return list(_each_line(Path(path)))


def _each_line(path: Path) -> Iterator[PlayerLine]:
    for number, content in read_lines(path, MAX_LINE):
        source = f"{one_line(str(path))}: line {number}"
        if content is None:
            raise ValueError(f"{source}: expected at most {MAX_LINE} bytes, got more")
        if content.strip():
            yield _line(parse_json(content, source), source)


def _line(data: object, source: str) -> PlayerLine:
    if not isinstance(data, Mapping) or set(data) != set(FIELDS):
        raise ValueError(f"{source}: expected an object with the fields {', '.join(FIELDS)}, got {show(data)}")
    player = data["player"] or NOBODY
    if not is_name(player):
        raise ValueError(f"{source}: player: expected a printable name, got {show(data['player'])}")
    episode, reward = data["episode"], data["reward"]
    if type(episode) is not int or not 0 <= episode <= MAX_EPISODE:
        raise ValueError(f"{source}: episode: expected a whole number from 0 to {MAX_EPISODE}, got {show(episode)}")
    if not _is_number(reward):
        raise ValueError(f"{source}: reward: expected a number, got {show(reward)}")
    if not isinstance(data["game"], str) or data["game"] not in ALL_GAMES:  # no path: that file would be read
        given = data["game"]
        raise ValueError(f"{source}: game: expected the name of a game, got {show(given)} ({hint(str(given))})")
    scene = load_scene(data["game"])
    plan = _plan(scene, data["actions"], source)
    return PlayerLine(Play(str(player), scene, plan, PEOPLE_FPS, "float64", episode + 1), episode, float(reward))


def _is_number(value: object) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and -sys.float_info.max <= value <= sys.float_info.max  # type: ignore[operator]


def _plan(scene: Scene, actions: Any, source: str) -> tuple[int, ...]:  # noqa: ANN401
    """Return the steps of clicks; a click at t goes before the step whose clock shows t."""
    clock = official_clock(PEOPLE_FPS)
    plan, alive = [NEVER] * len(scene.eliminable_blocks), np.ones(scene.n_objects, bool)
    for click in actions if isinstance(actions, list) else [actions]:
        if not isinstance(click, list) or len(click) != 3 or not all(map(_is_number, click)):
            raise ValueError(f"{source}: actions: expected clicks [x, y, t] of finite numbers, got {show(click)}")
        x, y, time = (float(part) for part in click)
        if not 0 <= time < TIME_LIMIT:
            raise ValueError(f"{source}: actions: expected times from 0 to below {TIME_LIMIT:g} s, got {show(time)}")
        block = block_at(scene, x, y, alive)
        if block is None:
            raise ValueError(f"{source}: actions: expected a click on a block that is left, got {show(click)}")
        alive[block] = False
        plan[scene.eliminable_blocks.index(block)] = int(np.abs(clock - time).argmin())
    return tuple(plan)


def write_player_lines(path: str | os.PathLike[str], plays: Iterable[Play]) -> None:
    """Write plays as the official player lines, in place of an older file; episodes are counted for each player.

    The official loop plays episode e in reset e + 1, and so does `read_player_lines`. Plays that were made in another
    reset, as all later ones in a fresh space were, may end otherwise there.

    Args:
        path: of the file.
        plays: of games of the package, at 60 steps a second, with their results.

    Raises:
        ValueError: a play has another rate or no result, or its scene is no game; one line.
        OSError: the file cannot be written.
    """
    clock = official_clock(PEOPLE_FPS).tolist()
    counts: dict[tuple[str, str], int] = {}
    lines = []
    for number, play in enumerate(plays):
        scene, result = play.scene, play.result
        if play.fps != PEOPLE_FPS or result is None:
            raise ValueError(f"plays[{number}]: expected a play at {PEOPLE_FPS} steps a second with its result")
        if not is_game(scene):
            raise ValueError(f"plays[{number}]: expected a game of the package, got the scene {show(scene.name)}")
        executed = [(step, block) for step, block in zip(play.plan, scene.eliminable_blocks, strict=True) if step >= 0]
        last, centres = int(str(result["steps"])), scene.centres
        clicks = [[*centres[block].tolist(), clock[step]] for step, block in sorted(executed) if step < last]
        episode = counts[play.agent, scene.name] = counts.get((play.agent, scene.name), -1) + 1
        fields = (play.agent, scene.name, episode, clicks, result["reward"])
        lines.append(json.dumps(dict(zip(FIELDS, fields, strict=True))))
    replace_text(Path(path), "".join(f"{line}\n" for line in lines))


def dataset_from_plays(plays: Iterable[Play]) -> Dataset:
    """Return a data set of plays, labelled anew in a fresh space and in float64.

    Its steps are those that the rule "simulate" makes of its times: a removal before the first step, or a second one
    before the same step, goes a step later.

    Args:
        plays: of one rate; of `read_plays`, or those of player lines.

    Raises:
        ValueError: there are none, or they have different rates, or one that a data set cannot hold; one line.
    """
    given = list(plays)
    rates = sorted({play.fps for play in given})
    if len(rates) != 1:
        raise ValueError(f"plays: expected plays of one rate, got {', '.join(map(str, rates)) or 'no plays'}")
    if rates[0] > MOST_FPS:
        raise ValueError(f"plays: expected a rate of at most {MOST_FPS}, got {rates[0]}")
    scenes = list(dict.fromkeys(play.scene for play in given))
    game = np.array([scenes.index(play.scene) for play in given])
    slots = max(scene.limits.blocks for scene in scenes)
    steps = np.array([[*play.plan, *[NEVER] * (slots - len(play.plan))] for play in given], np.int64)
    protocol = PlayProtocol(rates[0])
    times = steps_to_times(steps, rates[0])
    labels = label_plans(scenes, game, protocol.steps(times), protocol)
    columns = labels.columns(np.array([int((game[:k] == game[k]).sum()) for k in range(len(game))]))
    entries = [{**scene_entry(scene), "players": _players(given, scene)} for scene in scenes]
    recipe = Recipe(distribution="plays", protocol=protocol)
    return build(scenes, game, times, columns, recipe, Journal(), {"scenes": entries})


def _players(plays: list[Play], scene: Scene) -> list[str]:
    return [play.agent for play in plays if play.scene == scene]
