"""What a sequence model is worth, and what bounds it: the same games, rate, rule and reset as its data."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.data.draws import random_plans
from iphyre_jax.data.labels import PlayProtocol
from iphyre_jax.data.official_files import drawn_times
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.models.outcome.plays.inputs import scene_rows
from iphyre_jax.models.sequence.agent import Player, contrast
from iphyre_jax.models.sequence.settings import ASKED, SequenceConfig
from iphyre_jax.models.sequence.training import Params, of_seed
from iphyre_jax.models.sequence.worlds import play
from iphyre_jax.scenes import GAMES, MAX_ELIMINABLE, SPLITS, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, GAME_LISTS

SAMPLED: Final[Mapping[str, int]] = {"in-advance": 10, "combined": 5, "on-the-fly": 5}  # sampled episodes of a game
SWEEP: Final = (0.0, 0.25, 0.5, 0.75, ASKED, 1.0)  # returns asked for
CANDIDATES: Final = 32  # sampled plans of which the most contrasting one is played
RANDOM: Final = 100  # random plans of a game
SEED: Final = 1000  # of random keys, beside those of the training

Floats = npt.NDArray[np.float64]
Result = dict[str, Any]


def result(reward: Floats, success: npt.NDArray[np.bool_]) -> Result:
    """Rewards and successes (K, G, E), of K seeds, G games and E episodes, as JSON values."""
    episodes = reward.shape[2]
    spread = reward.var(axis=2, ddof=1) / episodes if episodes > 1 else np.zeros(reward.shape[:2])
    games = [ALL_GAMES[k] in GAMES for k in range(reward.shape[1])]
    error = float(np.sqrt(spread[:, games].mean(axis=0).sum() / len(reward)) / sum(games))
    return {
        "episodes": episodes,
        "games": list(ALL_GAMES[: reward.shape[1]]),
        "reward": reward.mean(axis=2).tolist(),
        "success": success.mean(axis=2).tolist(),
        "standard error over episodes, all": error if episodes > 1 else None,
    }


@default_options()
def evaluate(config: SequenceConfig, params: Params, seeds: int) -> dict[str, Any]:
    """Play the fifty games with the models of some seeds: greedily, with sampled actions, and asked for other returns.

    Returns:
        JSON values: "greedy", "sampled" and, for events in advance, "contrast", as `result` gives them; "sweep": for
        each return asked for the mean reward of the first seed's greedy play on basic and on all games.
    """
    each = [_one(config, of_seed(params, seed), seed) for seed in range(seeds)]
    found = {
        mode: result(*(np.stack([part[mode][k] for part in each]) for k in range(2)))  # type: ignore[arg-type]
        for mode in each[0]
    }
    return {**found, "sweep": sweep(config, of_seed(params, 0))}


def _one(config: SequenceConfig, params: Params, seed: int) -> dict[str, tuple[Floats, npt.NDArray[np.bool_]]]:
    """Rewards and successes of one model, (G, E) each, by mode."""
    episodes = SAMPLED[config.strategy]
    key = jax.random.key(SEED + seed)
    found = {
        "greedy": _played(config, params, 1, ASKED, None),
        "sampled": _played(config, params, episodes, ASKED, key),
    }
    if config.form == "events" and config.strategy == "in-advance":
        found["contrast"] = _contrasting(config, params, key)
    return found


def _worlds(episodes: int) -> npt.NDArray[np.int32]:
    return np.repeat(np.arange(len(ALL_GAMES), dtype=np.int32), episodes)


def _played(
    config: SequenceConfig, params: Params, episodes: int, asked: float, key: jax.Array | None
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    scenes, game = [load_scene(name) for name in ALL_GAMES], _worlds(episodes)
    player = Player(config, params, scenes, game, asked, key)
    player.plans()
    played = play(scenes, game, player.steps(), config.protocol)
    return played.reward.reshape(-1, episodes), played.success.reshape(-1, episodes)


def _contrasting(config: SequenceConfig, params: Params, key: jax.Array) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Of sampled plans, the one that a high return makes likelier most, compared with a failure."""
    scenes, game = [load_scene(name) for name in ALL_GAMES], _worlds(CANDIDATES)
    player = Player(config, params, scenes, game, ASKED, key)
    player.plans()
    best = contrast(player).reshape(-1, CANDIDATES).argmax(axis=1)
    chosen = player.steps().reshape(-1, CANDIDATES, MAX_ELIMINABLE)[np.arange(len(best)), best]
    played = play(scenes, _worlds(1), chosen, config.protocol)
    return played.reward[:, None], played.success[:, None]


@default_options()
def sweep(config: SequenceConfig, params: Params) -> dict[str, list[float]]:
    """Mean rewards of greedy play on the basic and on the forty games, by the return asked for."""
    asked = SWEEP if config.strategy == "in-advance" else SWEEP[::2]
    found = {}
    for each in asked:
        reward = _played(config, params, 1, each, None)[0][:, 0]
        rows = [[ALL_GAMES.index(name) for name in names] for names in (SPLITS["basic"], GAMES)]
        found[str(each)] = [float(reward[own].mean()) for own in rows]
    return found


def doing_nothing(protocol: PlayProtocol) -> Result:
    """No removal in any game."""
    return _of_plans({name: np.full((1, MAX_ELIMINABLE), np.nan) for name in ALL_GAMES}, protocol)


def randomly(protocol: PlayProtocol) -> Result:
    """The first official random plans of each game."""
    plans = {}
    for name in ALL_GAMES:
        plans[name] = np.array([list(plan) for plan in islice(random_plans(load_scene(name), "official", 0), RANDOM)])
    return _of_plans(plans, protocol)


def nearest(learned: Dataset, protocol: PlayProtocol) -> Result:
    """Five solving plans of the most similar learned scene that has any: tables are compared number by number."""
    rows, solved = scene_rows(learned.scenes), np.isin(np.arange(len(learned.scenes)), learned.game[learned.success])
    plans, times = {}, drawn_times(learned)
    for name in ALL_GAMES:
        away = np.square(rows - scene_rows([load_scene(name)])).sum(axis=(1, 2))
        nearest_one = np.where(solved, away, np.inf).argmin()  # at 10 steps a second nothing solves seesaw
        own = np.flatnonzero((learned.game == nearest_one) & learned.success)
        plans[name] = times[np.resize(own, 5)]
    return _of_plans(plans, protocol)


def _of_plans(plans: Mapping[str, Floats], protocol: PlayProtocol) -> Result:
    """As many plans of each game, (E, 6) s; 0 or NaN is never."""
    scenes, episodes = [load_scene(name) for name in ALL_GAMES], len(next(iter(plans.values())))
    times = np.concatenate([plans[name] for name in ALL_GAMES])
    blocks = np.repeat([len(scene.eliminable_blocks) for scene in scenes], episodes)
    there = np.arange(MAX_ELIMINABLE) < blocks[:, None]  # a similar scene may have more
    times = np.where(there & (times != 0), times, np.nan)
    played = play(scenes, _worlds(episodes), protocol.steps(times), protocol)
    shape = 1, len(ALL_GAMES), episodes
    return result(played.reward.reshape(shape), played.success.reshape(shape))


def split_means(found: Mapping[str, Any], split: str) -> tuple[Floats, Floats]:
    """Mean reward and share solved of each seed, (K,), on a split or on "all" forty games."""
    rows = [found["games"].index(name) for name in GAME_LISTS[split] if name in found["games"]]
    reward, success = (np.asarray(found[key], np.float64) for key in ("reward", "success"))
    return reward[:, rows].mean(axis=1), success[:, rows].mean(axis=1)
