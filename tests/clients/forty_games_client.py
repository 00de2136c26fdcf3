"""`examples/ppo_forty_games.py` against this package's own trainer: the same games, episodes and seed."""

from __future__ import annotations

import runpy
import tempfile
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from score import Score, leave, now, record

import iphyre_jax
from iphyre_jax.scenes import GAMES
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.loop import train
from iphyre_jax.train.settings.run import TrainConfig

EXAMPLE = Path(__file__).parents[2] / "examples" / "ppo_forty_games.py"
SHARE = 0.97  # of the trainer's score, which differs by so much from seed to seed
EPISODES = 128  # of each game, of the trained agent and of random play


def main() -> bool:
    """Train both, write the record of the example."""
    start = now()
    example = runpy.run_path(str(EXAMPLE))
    _, rewards = jax.jit(example["make_train"]())(jax.random.key(0))
    score = Score.of(np.asarray(rewards)[-1])
    print(f"example: {score.mean:.1f}", flush=True)
    chance = iphyre_jax.evaluate(
        lambda key, _: jax.random.uniform(key, (6,)), "all", strategy="in-advance", episodes=EPISODES
    )
    config = TrainConfig(games=tuple(GAMES), updates=example["UPDATES"], episodes_per_scene=example["EPISODES"])
    with tempfile.TemporaryDirectory() as folder:
        result = train(config, Path(folder) / "run", Console(quiet=True))
    own = evaluate(config, result.state.learner, config.games).mean("sampled").reward
    ran = f"PPO of examples/ppo_forty_games.py, {rewards.size} decisions, all forty games; the trainer gets {own:.1f}"
    random = Score.of(chance.reward)
    good = record("example-forty-games", "iphyre-jax", ran, since=start, score=score, random=random)
    return good and score.mean >= SHARE * own


if __name__ == "__main__":
    leave(main())
