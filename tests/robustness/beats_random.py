"""`make test-learners`: every learner beats the random agent on two games within a minute each, real physics."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

from iphyre_jax import configure
from iphyre_jax.train import trainer
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import preset

GAMES = ("support", "direction")
SECONDS = 60.0  # of playing and learning, without the first update, which compiles
MARGIN = 50.0  # points of mean reward of sampled episodes


def main() -> int:
    """Train each agent for at most a minute; 0 if all of them beat the random one."""
    configure()
    good = True
    for strategy in ("in-advance", "combined", "on-the-fly"):
        chance = preset("random", strategy)
        random = evaluate(replace(chance, sampled_episodes=200), trainer.start(chance).learner, GAMES).mean("sampled")
        for agent in (name for name, spec in AGENTS.items() if strategy in spec.strategies and name != "random"):
            config = replace(preset(agent, strategy, "quick"), games=GAMES)
            runner = trainer.Trainer(config, trainer.start(config))
            runner.update_step()
            begun = time.monotonic()
            for _ in range(1, config.updates):
                if time.monotonic() - begun > SECONDS:
                    break
                runner.update_step()
            took = time.monotonic() - begun
            found = evaluate(config, runner.state.learner, GAMES).mean("sampled")
            fine = found.reward > random.reward + MARGIN
            good &= fine
            print(f"{agent} {strategy}: {found.reward:.1f} after {took:.0f} s, random {random.reward:.1f}", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
