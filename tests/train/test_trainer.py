"""One update: what a GPU plays more of, so that it compiles less, changes no number."""

from __future__ import annotations

from dataclasses import replace

import pytest

from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.train import trainer
from iphyre_jax.train.settings.run import preset


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly", "combined"])
def test_greedy_episodes_are_the_same_in_as_many_worlds_as_sampled_ones(
    strategy: StrategyName, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(
        preset("ppo", strategy, "quick"), games=("support", "hole"), hidden_sizes=(8,), episodes_per_scene=4
    )
    runner = trainer.Trainer(config, trainer.start(config))
    expected = runner.greedy_reward()
    monkeypatch.setattr(trainer, "on_cpu", lambda: False)
    assert runner.greedy_reward() == expected
