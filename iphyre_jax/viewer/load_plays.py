"""Load plays from files of plays, from run folders, of policies of the package, or from the best known plans."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from iphyre_jax.checks import one_line, show
from iphyre_jax.files import MAX_JSON_BYTES, parse_json, read_json_object
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.scenes import SCENE_SCHEMA, load_scene
from iphyre_jax.scenes.library import ALL_GAMES
from iphyre_jax.scenes.limits import MAX_NAME
from iphyre_jax.viewer.plays import SCHEMA, VERSION, Play, iter_plays, play_from_json, read_scene_field

BEST: Final = "best"
ORACLE: Final = ("analyses", "oracle-60fps.json")  # data of the package
POLICIES: Final = ("train", "weights")  # likewise
SOURCES: Final = "a file of plays (JSON lines), a run folder, a policy of the package that plans in advance, or best"


def load_plays(source: str | Path) -> list[Play]:
    """Return the plays of a source.

    Args:
        source: a file of plays (JSON lines), a run folder of an evaluated agent that plans in advance, the name of such
            a policy of the package, or "best" for the best known plans at 60 steps a second.

    Raises:
        FileNotFoundError, OSError, ValueError: one line that names the source and what was expected.
    """
    return list(each_play(source))


def each_play(source: str | Path) -> Iterator[Play]:
    """Yield the plays of a source; of a long file one line at a time is in memory. Arguments as for `load_plays`."""
    if str(source) == BEST:
        yield from best_plays().values()
        return
    if not isinstance(source, str | Path) or "\0" in str(source):
        raise ValueError(f"source: expected {SOURCES}, got {show(source)}")
    path = Path(source)
    if not path.exists() and is_policy(str(source)):
        yield from _plays_of_policy(str(source))
        return
    _refuse_others(str(source), path)
    yield from _plays_of_run(path) if path.is_dir() else iter_plays(path, required=True)


def _refuse_others(source: str, path: Path) -> None:
    """Say what takes a scene or a data set, if that is what was given instead of plays; ValueError in one line."""
    name, wanted = one_line(source), f"expected {SOURCES}"
    if not path.exists() and source in ALL_GAMES:
        raise ValueError(f"{name}: {wanted}, got a game; `iphyre-jax render {name}` draws it")
    if path.suffix.lower() == ".npz" and path.is_file():
        raise ValueError(f"{name}: {wanted}, got arrays; `iphyre_jax.data` reads data sets")
    if path.suffix.lower() != ".json" or not path.is_file():
        return
    with path.open("rb") as file:
        try:
            content = parse_json(file.read(MAX_JSON_BYTES + 1), name)
        except ValueError:
            return  # `read_plays` says what is wrong
    if isinstance(content, Mapping) and content.get("schema") == SCENE_SCHEMA:
        raise ValueError(f"{name}: {wanted}, got a scene; `iphyre-jax render {name}` draws it")


@cache
def best_plays() -> Mapping[str, Play]:
    """Return for each of the forty games the best plan that the oracle found at 60 steps a second, in a fresh space."""
    content: Any = parse_json(files("iphyre_jax").joinpath(*ORACLE).read_bytes(), ORACLE[-1])
    return {row["game"]: _best_play(row) for row in content["games"]}


def _best_play(row: Mapping[str, Any]) -> Play:
    """Return the play of a row that `analyses.oracle` wrote."""
    steps = round(row["seconds"] * PEOPLE_FPS)
    result = {"solved": row["solved"], "steps": steps, "eliminations": len(row["order"]), "reward": row["reward"]}
    return Play("best plan known", load_scene(row["game"]), tuple(row["plan"]), PEOPLE_FPS, "float64", 1, result)


def _plays_of_run(path: Path) -> list[Play]:
    """Return the greedy plans in the evaluation of a run."""
    config, evaluation = (_object(path / name) for name in ("config.json", "evaluation.json"))
    settings = config.get("settings")
    games = evaluation.get("games")
    if not isinstance(settings, Mapping) or not isinstance(games, list):
        raise ValueError(f"{one_line(str(path))}: expected the settings of a run and an evaluation of its games")
    if not games:
        raise ValueError(f"{one_line(str(path))}: expected at least one play, got none")
    agent, file = one_line(path.resolve().name).strip()[:MAX_NAME] or "run", one_line(str(path / "evaluation.json"))
    return [_greedy_play(game, settings, agent, f"{file}: games[{k}]") for k, game in enumerate(games)]


def is_policy(name: str) -> bool:
    """Return whether the package has a trained policy of this name."""
    return name == Path(name).name and files("iphyre_jax").joinpath(*POLICIES, f"{name}.json").is_file()


def _plays_of_policy(name: str) -> list[Play]:
    """Return the greedy plans of a policy of the package."""
    file = f"{name}.json"
    content: Any = parse_json(files("iphyre_jax").joinpath(*POLICIES, file).read_bytes(), file)
    games = enumerate(content["scores"]["games"])
    return [_greedy_play(game, content["settings"], name, f"{file}: games[{k}]") for k, game in games]


def _greedy_play(game: object, settings: Mapping[str, Any], agent: str, source: str) -> Play:
    """Return the greedy plan of one game in an evaluation."""
    if not isinstance(game, Mapping) or not isinstance(game.get("game"), str):
        raise ValueError(f"{source}: expected an object with the name of a game, got {show(game)}")
    seconds, fps = game.get("plan"), settings.get("fps", 10)
    numbers = (int, float, type(None))
    if not isinstance(seconds, list) or not all(isinstance(second, numbers) for second in seconds):
        raise ValueError(f"{source}: plan: expected seconds for each block, or null, got {show(seconds)}")
    scene = game.get("scene", game["game"])  # of a scene that is no game of the package
    blocks = len(read_scene_field(scene, source).eliminable_blocks)
    if blocks and not seconds:
        raise ValueError(f"{source}: plan: expected a plan, got none; only agents that plan in advance have plans")
    if not isinstance(fps, int) or isinstance(fps, bool) or any(s is not None and not 0 <= s < 1e6 for s in seconds):
        raise ValueError(f"{source}: plan: expected seconds from 0 on at a whole number of steps a second")
    plan = [-1 if second is None else round(second * fps) for second in seconds]
    fields = {"schema": SCHEMA, "version": VERSION, "agent": agent, "scene": scene, "plan": plan[:blocks]}
    physics = {"fps": fps, "dtype": settings.get("dtype", "float32"), "resets": settings.get("resets", 2)}
    return play_from_json(fields | physics, source)


def _object(path: Path) -> Mapping[str, Any]:
    name = one_line(str(path))
    if not path.is_file():
        hint = "; `iphyre-jax evaluate` writes it" if path.name == "evaluation.json" else ""
        raise FileNotFoundError(f"{name}: expected this file of a run folder, but there is none{hint}")
    return read_json_object(path)
