"""Policies that ship with the package: stored, loaded as data, refused when damaged, and as good as they say."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from benchmarks.learning.rows import rows
from iphyre_jax import make
from iphyre_jax.train import trainer
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import TrainConfig, preset
from iphyre_jax.train.storage.pretrained import load_pretrained, names, rounded, save_pretrained

GAMES = ("support", "direction")
NONE: dict[str, Any] = {"splits": {}, "games": [], "faults": 0}
LEARNING = [(agent, spec.strategies[0]) for agent, spec in AGENTS.items() if agent != "random"]


@pytest.mark.slow
@pytest.mark.parametrize(("agent", "strategy"), LEARNING)
def test_a_policy_without_its_learner_acts_the_same(agent: str, strategy: str, tmp_path: Path) -> None:
    config = dataclasses.replace(preset(agent, strategy), hidden_sizes=(16,))  # type: ignore[arg-type]
    state = trainer.start(config).learner
    save_pretrained("one", config, rounded(config, state), NONE, {}, tmp_path)
    stored = load_pretrained("one", tmp_path)
    obs = start_observations(config.strategy, config.observation, GAMES)
    greedy = trainer.algorithm(config).greedy(state, obs)
    np.testing.assert_allclose(stored.greedy(obs), greedy, atol=0.01)
    assert stored.act(jax.random.key(0), obs).shape == greedy.shape


def test_damaged_or_unknown_policies_are_refused_in_one_line(tmp_path: Path) -> None:
    config = TrainConfig(hidden_sizes=(16,))
    save_pretrained("one", config, rounded(config, trainer.start(config).learner), NONE, {}, tmp_path)
    arrays, described = tmp_path / "one.npz", tmp_path / "one.json"
    raw, text = arrays.read_bytes(), described.read_text()
    with pytest.raises(ValueError, match="pretrained: expected one of one; got 'two'"):
        load_pretrained("two", tmp_path)
    for place in range(0, len(raw), len(raw) // 20):
        arrays.write_bytes(raw[:place] + bytes([raw[place] ^ 1]) + raw[place + 1 :])
        with pytest.raises(ValueError, match="damaged: it does not have the SHA-256 sum"):
            load_pretrained("one", tmp_path)
    arrays.write_bytes(raw)
    content = json.loads(text)
    for wrong, message in (
        ({**content, "version": 3}, "expected schema"),
        ({key: content[key] for key in content if key != "scores"}, "scores is missing"),
        ({**content, "settings": {**content["settings"], "hidden_sizes": [8]}}, "expected shape"),
        ({**content, "settings": {**content["settings"], "center_obs": False}}, "centre: not expected"),
    ):
        described.write_text(json.dumps(wrong))
        with pytest.raises(ValueError, match=message) as error:
            load_pretrained("one", tmp_path)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("agent", "strategy"), LEARNING)
def test_a_policy_that_diverged_is_not_scored(agent: str, strategy: str) -> None:
    config = dataclasses.replace(preset(agent, strategy), hidden_sizes=(16,))  # type: ignore[arg-type]
    good = rounded(config, trainer.start(config).learner)
    state = jax.tree.map(lambda leaf: leaf + np.nan if leaf.dtype.kind == "f" else leaf, good)
    with pytest.raises(ValueError, match=r"^policy: .+: expected finite numbers, got NaN or infinity") as error:
        evaluate(config, state, GAMES)
    assert "\n" not in str(error.value)


def test_archives_are_checked_before_they_are_read(tmp_path: Path) -> None:
    """All have a sum that fits: an empty file, one that unpacks to far more than the arrays need."""
    config = TrainConfig(hidden_sizes=(16,))
    save_pretrained("one", config, rounded(config, trainer.start(config).learner), NONE, {}, tmp_path)
    arrays, described = tmp_path / "one.npz", tmp_path / "one.json"
    content = json.loads(described.read_text())
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("bomb.npy", "w") as member:
        for _ in range(64):
            member.write(bytes(2**20))
    for raw, message in ((b"", "expected arrays of NumPy"), (packed.getvalue(), "bytes of arrays, got 67108864")):
        arrays.write_bytes(raw)
        described.write_text(json.dumps({**content, "sha256": hashlib.sha256(raw).hexdigest()}))
        with pytest.raises(ValueError, match=message) as error:
            load_pretrained("one", tmp_path)
        assert str(arrays) in str(error.value)
        assert "\n" not in str(error.value)


@pytest.mark.slow
def test_every_agent_ships_and_was_trained_as_its_row_of_the_results() -> None:
    agents = {config.paper_name.lower() for config in rows().values() if config.agent != "random"}
    assert agents <= set(names()) <= set(rows())
    for name in names():
        policy = load_pretrained(name)
        assert dataclasses.replace(policy.config, seed=0, pool_sha256="") == rows()[name]
        assert name.startswith(policy.config.paper_name.lower())
        assert set(policy.scores["splits"]) == {"basic", "noisy", "compositional", "multi_ball", "unseen_basic", "all"}


def test_greedy_episodes_on_the_fly_are_those_of_the_scores() -> None:
    policy = load_pretrained("ppo-o")
    env, params = make(f"on-the-fly/{GAMES[0]}-v1", observation=policy.config.observation, autoreset=False)
    step = jax.jit(env.step)
    obs, state = env.reset(jax.random.key(0), params)
    preferred, reward = policy.greedy_policy(), 0.0
    for _ in range(env.strategy.decisions):
        obs, state, gained, *_ = step(jax.random.key(0), state, preferred(obs[None])[0], params)
        reward += float(gained)
    shipped = {game["game"]: game["greedy"]["reward"] for game in policy.scores["games"]}
    assert reward == pytest.approx(shipped[GAMES[0]], abs=0.5)


@pytest.mark.parametrize(
    ("games", "message"),
    [
        ("hole", r"^scenes: expected a sequence of at least one name, file or Scene$"),
        (["hole", "holes"], r"^scene: expected the name of a game or the path of a scene file, got 'holes'"),
    ],
)
def test_what_is_no_game_is_refused(games: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_pretrained("ppo-i").evaluate(games)


def test_other_observations_are_one_line() -> None:
    policy = load_pretrained("ppo-i")
    for obs in (np.zeros(120, np.float32), np.zeros((2, 122), np.float32)):
        for act in (policy.greedy, policy.greedy_policy(), partial(policy.act, jax.random.key(0))):
            with pytest.raises(ValueError, match=r"^observation: expected shape \(B, 120\), got"):
                act(obs)
    for strategy, observation in (("in_advance", "official"), ("in-advance", "motoin")):
        with pytest.raises(ValueError, match=r"^(strategy|observation): expected one of"):
            start_observations(strategy, observation, GAMES)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["ppo-i", "ddpg-i"])
def test_a_policy_reaches_the_scores_that_it_ships_with(name: str) -> None:
    policy = load_pretrained(name)
    found = policy.evaluate(GAMES)
    shipped = {game["game"]: game["greedy"]["reward"] for game in policy.scores["games"]}
    for game in found.games:
        assert game.greedy.success
        assert game.greedy.reward == pytest.approx(shipped[game.game], abs=0.5)
