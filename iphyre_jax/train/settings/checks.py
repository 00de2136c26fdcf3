"""Which settings of a training run can work; `TrainConfig.check` asks here."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, get_args, get_origin, get_type_hints

from iphyre_jax.checks import MAX_RESETS, check_option, show, whole_fps
from iphyre_jax.envs.strategies import strategy_named
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, check_names_differ, hint, load_own_scenes, looks_like_path
from iphyre_jax.scenes.limits import OFFICIAL
from iphyre_jax.train.settings.agents import ATTENTION_HEADS, DQN, OffPolicy, PolicyGradient
from iphyre_jax.train.settings.presets import AGENTS

if TYPE_CHECKING:
    from iphyre_jax.train.settings.run import TrainConfig

MAX_WIDTH, MAX_LAYERS = 4096, 16  # of a network
MAX_COUNT: Final = 10**8  # of a learner's whole numbers
MAX_STEPS: Final = 2**31 - 1  # of a schedule, which counts gradient steps in int32
GROUP: Final = 32  # episodes of one scene in an update, which are compared with one another

_MOST: Final[Mapping[str, int]] = MappingProxyType(
    {
        "updates": 2**31 - 1,  # as a checkpoint counts them
        "checkpoint_seconds": 10**9,
        "episodes_per_scene": 10**6,
        "sampled_episodes": 10**6,
        "greedy_every": 2**31 - 1,
        "variations": 10**6,
        "pool_scenes": 10**6,
        "pool_topologies": 10**6,
        "added_blocks": 64,
    }
)


# What other settings need to have an effect; whether a run has it; the settings, of the run or its learner.
_NEEDS: Final[tuple[tuple[str, Callable[[TrainConfig], bool], tuple[str, ...]], ...]] = (
    ("variations", lambda run: run.variations > 0, ("added_blocks",)),
    ("a scene_pool", lambda run: run.scene_pool != "", ("pool_scenes", "pool_share", "curriculum", "pool_topologies")),
    ("the network mlp", lambda run: run.network == "mlp", ("center_obs", "activation")),
    ("a next decision", lambda run: run.strategy != "in-advance", ("gamma", "gae_lambda", "n_step", "tau")),
    ("an agent that learns", lambda run: run.agent != "random", ("hidden_sizes",)),
    ("normalize_advantage", lambda run: getattr(run.learner, "normalize_advantage", "") != "none", ("std_floor",)),
    ("a critic", lambda run: getattr(run.learner, "critic", True), ("vf_coef", "value_clip")),
    ("a kl_coef", lambda run: getattr(run.learner, "kl_coef", 1) > 0, ("kl_target",)),
)


def check_config(config: TrainConfig) -> None:
    """Refuse settings that cannot work: ValueError, one line naming the field and what was expected."""
    _check_choices(config)
    _check_games(config)
    for name in ("resets", "updates", "sampled_episodes", "greedy_every"):
        _require(config, name, getattr(config, name) >= 1, "at least 1")
    for name in ("variations", "added_blocks"):
        _require(config, name, getattr(config, name) >= 0, "a number not below 0")
    _require(config, "resets", config.resets <= MAX_RESETS, f"at most {MAX_RESETS}")
    _require(config, "episodes_per_scene", config.episodes_per_scene >= 2, "at least 2")
    _require(config, "seed", 0 <= config.seed < 2**31, "from 0 to 2**31 - 1")
    widths = len(config.hidden_sizes) > 0 and min(config.hidden_sizes) >= 1
    _require(config, "hidden_sizes", widths, "at least one positive width")
    for name, most in _MOST.items():
        _require(config, name, getattr(config, name) <= most, f"at most {most}")
    depth = len(config.hidden_sizes) <= MAX_LAYERS and max(config.hidden_sizes) <= MAX_WIDTH
    _require(config, "hidden_sizes", depth, f"at most {MAX_LAYERS} widths of at most {MAX_WIDTH}")
    wide = config.network != "objects" or min(config.hidden_sizes) >= ATTENTION_HEADS
    _require(config, "hidden_sizes", wide, f"widths of at least {ATTENTION_HEADS}, the heads of attention")
    _require(config, "checkpoint_seconds", 0 <= config.checkpoint_seconds < float("inf"), "a number not below 0")
    _check_pool(config)
    _check_groups(config)
    _check_prediction(config)
    _check_learner(config)


def check_start(config: TrainConfig, base: TrainConfig) -> None:
    """Refuse settings that run and do not learn what they say; older runs with such settings can still be read.

    Args:
        config: checked by `check_config`.
        base: its preset.
    """
    learner = config.learner
    _require(config, "split", not config.games or config.split == base.split, "none beside games")
    for needed, present, names in _NEEDS:
        for name in names if not present(config) else ():
            of, default = (config, base) if hasattr(config, name) else (learner, base.learner)
            unused = getattr(of, name, None) == getattr(default, name, None)
            _require(of, name, unused, f"none without {needed}, as nothing would read it")
    own = load_own_scenes(config.games)
    for scene in own:
        expected = f"scenes that are not called as a game of the package, got {show(scene.name)}; give it another name"
        if scene.name in ALL_GAMES:
            raise ValueError(f"games: expected {expected}")
    check_names_differ("games", [load_scene(game) for game in config.games])
    if config.scene_pool and config.pool_share < 1:
        expected = f"more, of which the games keep a group of {GROUP} beside a pool_share of {config.pool_share:g}"
        _require(config, "episodes_per_scene", config.pool_groups < config.groups, expected)
    for entry in dataclasses.fields(learner):
        if (most := entry.metadata.get("most")) is not None:
            _require(learner, entry.name, getattr(learner, entry.name) <= most, f"at most {most}")
    if isinstance(learner, PolicyGradient) and learner.anneal_lr:
        most = MAX_STEPS // (getattr(learner, "epochs", 1) * learner.minibatches)
        _require(config, "updates", config.updates <= most, f"at most {most}, for the schedule of the learning rate")
    if isinstance(learner, OffPolicy):
        decisions = strategy_named(config.strategy).decisions
        _require(learner, "n_step", learner.n_step <= decisions, f"at most {decisions}, the decisions of an episode")
        kept = learner.capacity(config.decisions_per_update)
        _require(learner, "warmup", learner.warmup <= kept, f"at most {kept}, the transitions that are kept")
    if getattr(learner, "kl_coef", 0) > 0:
        _require(learner, "kl_target", getattr(learner, "kl_target", 0) > 0, "a positive number with a kl_coef")
    if isinstance(learner, DQN):
        _require(learner, "no_op_prob", 0 < learner.no_op_prob < 1, "a number between 0 and 1")


def _require(record: object, name: str, holds: bool, expected: str) -> None:
    """Raise the one-line error of a field unless its condition holds."""
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {show(getattr(record, name))}")


def _check_literals(record: object) -> None:
    """Refuse a name that the type of its field does not list."""
    for name, kind in get_type_hints(type(record)).items():
        if get_origin(kind) is Literal:
            check_option(name, getattr(record, name), get_args(kind))


def _check_choices(config: TrainConfig) -> None:
    """Refuse names that do not exist, or not together."""
    check_option("split", config.split, tuple(SPLITS))
    _check_literals(config)
    spec = AGENTS[config.agent]
    possible = config.strategy in spec.strategies
    _require(config, "strategy", possible, f"{' or '.join(spec.strategies)} with agent {config.agent}")
    heads = spec.heads(config.strategy)
    _require(config, "head", config.head in heads, f"{' or '.join(heads)} with {config.agent} {config.strategy}")
    gradient = issubclass(spec.settings, PolicyGradient)
    _require(config, "network", gradient or config.network == "mlp", "mlp unless with ppo or a2c")
    if config.strategy != "in-advance":
        _require(config, "dtype", config.dtype == "float32", "float32 unless in advance")
        _require(config, "variations", config.variations == 0, "0 unless in advance")
    else:
        _require(config, "observation", config.observation == "official", "official in advance: nothing moves yet")


def _check_games(config: TrainConfig) -> None:
    """Refuse games that do not exist, scene files that are not valid and rates that do not fit."""
    for game in set(config.games).difference(ALL_GAMES):
        if not Path(game).exists():
            if looks_like_path(game):  # what plays it says that it is gone; a report of the run needs no file
                continue
            raise ValueError(
                f"games: expected names of games of the package or scene files, got {show(game)} ({hint(game)})"
            )
        if load_scene(game).limits != OFFICIAL:
            raise ValueError(
                f"games: expected scenes without limits of their own, for the networks' sizes, got {game!r}"
            )
    if whole_fps(config.fps) % 10:
        raise ValueError(f"fps: expected a multiple of 10, got {config.fps}")


def _check_pool(config: TrainConfig) -> None:
    """Refuse a pool that cannot be; its file is looked at when a run starts."""
    if config.strategy != "in-advance" or not config.scene_pool:
        _require(config, "scene_pool", not config.scene_pool, "none unless in advance")
        _require(config, "pool_sha256", not config.pool_sha256, "none without a scene_pool")
    for name in ("pool_scenes", "pool_topologies"):
        _require(config, name, getattr(config, name) >= 1, "at least 1")
    _require(config, "pool_share", 0 < config.pool_share <= 1, "a number above 0 and at most 1")


def _check_prediction(config: TrainConfig) -> None:
    """Refuse a prediction that cannot be; its world model is looked at when a run starts."""
    if not config.prediction:
        _require(config, "prediction_sha256", not config.prediction_sha256, "none without a prediction")
        return
    _require(config, "prediction", config.strategy != "in-advance", "none in advance: nothing moves yet")
    _require(config, "network", config.network == "mlp", "mlp with a prediction")
    fits = config.fps == 60 or not config.world_model
    _require(config, "fps", fits, "60 with a world model, which learned at that rate")


def _check_learner(config: TrainConfig) -> None:
    """Refuse settings of the algorithm that cannot work."""
    learner, known = config.learner, AGENTS[config.agent].settings
    if type(learner) is not known:
        raise ValueError(f"learner: expected settings of {config.agent}, got {type(learner).__name__}")
    for entry in dataclasses.fields(learner):
        value = getattr(learner, entry.name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        positive, least = "positive" in entry.metadata, entry.metadata.get("least", 0)
        finite = least <= value < float("inf") and (value > 0 or not positive)
        _require(learner, entry.name, finite, "a positive number" if positive else f"a number not below {least}")
        _require(learner, entry.name, isinstance(value, float) or value <= MAX_COUNT, f"at most {MAX_COUNT}")
    _check_literals(learner)
    if isinstance(learner, PolicyGradient):
        if config.strategy != "in-advance" and not learner.samples_per_update:
            raise ValueError("samples_per_update: expected a number of decisions unless in advance, got 0")
        _check_minibatches(config, learner)


def _check_groups(config: TrainConfig) -> None:
    """Refuse episodes that the groups of a game cannot share equally."""
    fits = config.episodes_per_scene % config.groups == 0
    _require(config, "episodes_per_scene", fits, f"a multiple of {config.groups}, the groups of a game")


def _check_minibatches(config: TrainConfig, learner: PolicyGradient) -> None:
    """Refuse minibatches that are not of one size, or of scenes where there are none."""
    decisions = config.decisions_per_update
    count, unit = min(learner.samples_per_update or decisions, decisions), "decisions"
    if learner.minibatch_of == "scenes":
        in_advance = config.strategy == "in-advance" and not learner.samples_per_update
        _require(learner, "minibatch_of", in_advance, "decisions unless in advance without samples_per_update")
        count, unit = len(config.training_games) * config.groups, "scenes"
    _require(learner, "minibatches", count % learner.minibatches == 0, f"a divisor of {count} {unit} an update")
