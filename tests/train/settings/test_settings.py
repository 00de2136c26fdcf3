"""Settings: what is refused, and the way through JSON."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest

from iphyre_jax import SPLITS
from iphyre_jax.train.settings.agents import DDPG, DQN, PPO, SAC
from iphyre_jax.train.settings.codec import config_from_json
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import TrainConfig, preset

FLY: dict[str, Any] = {"strategy": "on-the-fly", "head": "categorical"}
DDPG_I: dict[str, Any] = {"agent": "ddpg", "head": "deterministic"}

BAD: dict[str, tuple[dict[str, Any], str]] = {
    "split": ({"split": "advanced"}, "split: expected one of basic"),
    "games": (
        {"games": ("hole", "hol")},
        "games: expected names of games of the package or scene files, got 'hol' .did you mean hole",
    ),
    "fps": ({"fps": 25}, "fps: expected a multiple of 10"),
    "no fps": ({"fps": 0}, "fps: expected a positive whole number"),
    "dtype": ({"dtype": "bfloat16"}, "dtype: expected one of float32, float64"),
    "agent": ({"agent": "td3"}, "agent: expected one of ppo, a2c"),
    "strategy": ({"strategy": "never"}, "strategy: expected one of in-advance"),
    "agent's strategy": (
        {"agent": "dqn", "learner": DQN()},
        "strategy: expected on-the-fly with agent dqn, got 'in-advance'",
    ),
    "preset": ({"preset": "best"}, "preset: expected one of default, quick, paper"),
    "head": ({"head": "beta"}, "head: expected one of time_grid"),
    "agent's head": (
        {"head": "tanh_normal"},
        "head: expected time_grid or gaussian with ppo in-advance, got 'tanh_normal'",
    ),
    "learner": ({"learner": DQN()}, "learner: expected settings of ppo, got DQN"),
    "motion": ({"observation": "motion"}, "observation: expected official in advance"),
    "network": ({"network": "cnn"}, "network: expected one of mlp, objects"),
    "dtype on the fly": (FLY | {"dtype": "float64"}, "dtype: expected float32 unless in advance"),
    "samples_per_update": (FLY, "samples_per_update: expected a number of decisions unless in advance, got 0"),
    "variations": ({"variations": -1}, "variations: expected a number not below 0"),
    "pool on the fly": (FLY | {"scene_pool": "pool.npz"}, "scene_pool: expected none unless in advance"),
    "sum of no pool": ({"pool_sha256": "0" * 64}, "pool_sha256: expected none without a scene_pool"),
    "no scene of a pool": ({"pool_scenes": 0}, "pool_scenes: expected at least 1"),
    "no share": ({"pool_share": 0.0}, "pool_share: expected a number above 0 and at most 1"),
    "too large a share": ({"pool_share": 1.5}, "pool_share: expected a number above 0 and at most 1"),
    "curriculum": ({"curriculum": "hardest"}, "curriculum: expected one of learnability, uniform"),
    "greedy": ({"greedy_every": 0}, "greedy_every: expected at least 1"),
    "checkpoints": ({"checkpoint_seconds": -1.0}, "checkpoint_seconds: expected a number not below 0"),
    "resets": ({"resets": 0}, "resets: expected at least 1"),
    "updates": ({"updates": 0}, "updates: expected at least 1"),
    "one plan": ({"episodes_per_scene": 1}, "episodes_per_scene: expected at least 2"),
    "unequal groups": (
        {"episodes_per_scene": 100, "variations": 4},
        "episodes_per_scene: expected a multiple of 3, the groups of a game, got 100",
    ),
    "seed": ({"seed": -1}, "seed: expected from 0"),
    "no layer": ({"hidden_sizes": ()}, "hidden_sizes: expected at least one positive width"),
    "empty layer": ({"hidden_sizes": (32, 0)}, "hidden_sizes: expected at least one positive width"),
    "learning rate": ({"learner": PPO(learning_rate=0.0)}, "learning_rate: expected a positive number"),
    "not a number": ({"learner": PPO(clip_eps=float("nan"))}, "clip_eps: expected a positive number"),
    "entropy": ({"learner": PPO(ent_coef=-0.1)}, "ent_coef: expected a number not below 0"),
    "minibatches": (
        {"learner": PPO(minibatches=7)},
        "minibatches: expected a divisor of 1280 decisions an update, got 7",
    ),
    "minibatches of scenes": (
        {"learner": PPO(minibatches=4, minibatch_of="scenes")},
        "minibatches: expected a divisor of 10 scenes an update, got 4",
    ),
    "advantage": (
        {"learner": PPO(normalize_advantage="game")},  # type: ignore[arg-type]
        "normalize_advantage: expected one of scene, batch, none, got 'game'",
    ),
    "minibatch of what": (
        {"learner": PPO(minibatch_of="games")},  # type: ignore[arg-type]
        "minibatch_of: expected one of decisions, scenes",
    ),
    "scenes on the fly": (
        FLY | {"learner": PPO(samples_per_update=64, minibatch_of="scenes")},
        "minibatch_of: expected decisions unless in advance",
    ),
    "minibatches of few decisions": (
        FLY | {"games": ("hole",), "episodes_per_scene": 4, "learner": PPO(samples_per_update=8192, minibatches=32)},
        "minibatches: expected a divisor of 600 decisions an update, got 32",
    ),
    "narrow attention": (
        {"network": "objects", "hidden_sizes": (8, 3)},
        r"hidden_sizes: expected widths of at least 4, the heads of attention, got a list of 2",
    ),
    "no topology": ({"pool_topologies": 0}, "pool_topologies: expected at least 1"),
}

COMBINED: dict[str, Any] = {"strategy": "combined"}
SAC_C: dict[str, Any] = COMBINED | {"agent": "sac", "head": "tanh_normal"}
USELESS: dict[str, tuple[dict[str, Any], str]] = {
    "too few episodes to share": (
        {"scene_pool": "pool.npz", "episodes_per_scene": 32},
        "episodes_per_scene: expected more, of which the games keep a group of 32 beside a pool_share of 0.5, got 32",
    ),
    "a share that leaves nothing": (
        {"scene_pool": "pool.npz", "episodes_per_scene": 64, "pool_share": 0.75},
        "episodes_per_scene: expected more, of which the games keep a group of 32 beside a pool_share of 0.75, got 64",
    ),
    "a schedule that does not count so far": (
        {"updates": 200_000_000, "learner": PPO(minibatches=4, epochs=4)},
        "updates: expected at most 134217727, for the schedule of the learning rate, got 200000000",
    ),
    "discount": (COMBINED | {"learner": PPO(gamma=5.0, samples_per_update=1024)}, "gamma: expected at most 1, got 5.0"),
    "lambda": (
        COMBINED | {"learner": PPO(gae_lambda=3.0, samples_per_update=1024)},
        "gae_lambda: expected at most 1, got 3.0",
    ),
    "share of a target": (SAC_C | {"learner": SAC(tau=2.0)}, "tau: expected at most 1, got 2.0"),
    "more steps than an episode has": (
        SAC_C | {"learner": SAC(n_step=8)},
        "n_step: expected at most 7, the decisions of an episode, got 8",
    ),
    "a weight that grows for ever": (
        {"learner": PPO(kl_coef=0.2, kl_target=0.0)},
        "kl_target: expected a positive number with a kl_coef, got 0.0",
    ),
    "learning that never begins": (
        DDPG_I | {"games": ("hole",), "learner": DDPG(buffer_size=500)},
        "warmup: expected at most 500, the transitions that are kept, got 1000",
    ),
    "never nothing": (
        FLY | {"agent": "dqn", "head": "categorical", "learner": DQN(no_op_prob=0.0)},
        "no_op_prob: expected a number between 0 and 1, got 0.0",
    ),
}


@pytest.mark.parametrize("case", USELESS)
def test_a_run_that_would_not_learn_what_it_says_does_not_start(case: str) -> None:
    """Runs of earlier versions with such settings can be read."""
    values, message = USELESS[case]
    config = TrainConfig(**values)
    assert config_from_json(json.loads(json.dumps(config.to_json())), "run") == config
    with pytest.raises(ValueError, match=message) as caught:
        config.check_start()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("case", BAD)
def test_bad_settings_get_one_line(case: str) -> None:
    values, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        TrainConfig(**values).check()
    assert "\n" not in str(caught.value)


def test_defaults_are_the_official_setting() -> None:
    config = TrainConfig()
    config.check()
    assert (config.fps, config.resets, config.dtype, config.split) == (10, 2, "float32", "basic")
    assert config.training_games == SPLITS["basic"]
    assert config.episodes_per_update == 1280
    assert TrainConfig(games=("hole", "spring")).training_games == ("hole", "spring")


def test_through_json_and_back() -> None:
    learner = PPO(learning_rate=1.0, minibatches=2)
    config = TrainConfig(seed=3, head="gaussian", hidden_sizes=(8, 9), games=("hole",), learner=learner)
    assert config_from_json(json.loads(json.dumps(config.to_json())), "run") == config


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([], "run: expected an object of settings, got list"),
        ({"sead": 1}, "run: unknown setting 'sead'"),
        ({"seed": "1"}, "run: seed: expected a value like 0, got '1'"),
        ({"seed": True}, "run: seed: expected a value like 0, got True"),
        ({"hidden_sizes": [1.5]}, "run: hidden_sizes: expected a value like"),
        ({"games": [3]}, "run: games: expected a value like"),
        ({"learner": {"clip_eps": None}}, "run: clip_eps: expected a value like 0.2, got None"),
        ({"learner": []}, "run: learner: expected an object of settings, got list"),
        ({"agent": "dqn", "learner": {"clip_eps": 0.1}}, "run: unknown setting 'clip_eps'"),
        ({"agent": 3}, "run: agent: expected one of ppo"),
        ({"fps": 15}, "run: fps: expected a multiple of 10, got 15"),
    ],
)
def test_bad_json_names_the_file(values: object, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        config_from_json(values, "run")
    assert str(caught.value).startswith(message)


def test_settings_cannot_change() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        TrainConfig().seed = 1  # type: ignore[misc]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"games": ("hole",), "split": "noisy"}, "split: expected none beside games, got 'noisy'"),
        ({"added_blocks": 2}, "added_blocks: expected none without variations, as nothing would read it, got 2"),
        ({"pool_share": 0.3}, "pool_share: expected none without a scene_pool, as nothing would read it, got 0.3"),
        ({"curriculum": "uniform"}, "curriculum: expected none without a scene_pool, as nothing would read it"),
        (
            {"network": "objects", "activation": "relu"},
            "activation: expected none without the network mlp, as nothing would read it, got 'relu'",
        ),
        ({"learner": PPO(vf_coef=0.1)}, "vf_coef: expected none without a critic, as nothing would read it, got 0.1"),
        (
            {"learner": PPO(gamma=0.5)},
            "gamma: expected none without a next decision, as nothing would read it, got 0.5",
        ),
        (DDPG_I | {"learner": DDPG(tau=0.5)}, "tau: expected none without a next decision, as nothing would read it"),
        (
            {"learner": PPO(normalize_advantage="none", std_floor=9.0)},
            "std_floor: expected none without normalize_advantage, as nothing would read it, got 9.0",
        ),
        ({"learner": PPO(kl_target=0.1)}, "kl_target: expected none without a kl_coef, as nothing would read it"),
    ],
)
def test_a_setting_that_nothing_reads_is_refused(settings: dict[str, Any], message: str) -> None:
    """Runs of earlier versions with such settings can be read."""
    config = TrainConfig(**settings)
    config.check()
    with pytest.raises(ValueError) as caught:
        config.check_start()
    assert str(caught.value).startswith(message)


def test_a_run_has_each_game_once() -> None:
    with pytest.raises(ValueError, match=r"^games: expected scenes of different names, got 'hole' twice$"):
        TrainConfig(games=("hole", "fill", "hole")).check_start()


@pytest.mark.parametrize(("agent", "strategy"), [(a, s) for a, spec in AGENTS.items() for s in spec.strategies])
def test_every_preset_can_start(agent: Any, strategy: Any) -> None:
    for name in ("default", "quick", "paper"):
        preset(agent, strategy, name).check_start()
