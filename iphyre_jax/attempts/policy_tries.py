"""Different tries of a trained policy: its greedy plan, then samples at a temperature that differ from those before.

Needs the extra `train`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.checks import MAX_SEED, check_least, check_positive, show
from iphyre_jax.envs.in_advance import action_to_times
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.plans import plan_to_steps, steps_to_times
from iphyre_jax.scenes import Scene
from iphyre_jax.train.algos.actor_critic import ActorCritic
from iphyre_jax.train.algos.base import State
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.observations import slot_mask, start_observations
from iphyre_jax.train.settings.run import TrainConfig

TEMPERATURE: Final = 3.0  # chosen by trials on generated scenes, see docs/results/carry-over.md
SAMPLES: Final = 64  # drawn for each try; the first that differs is tried
JUDGED: Final = 256  # drawn for all tries that are asked for at once, if they are judged
POLICY_WEIGHT: Final = 0.005  # chosen on generated scenes and variations of basic games
GREEDY_BONUS: Final = 0.8  # chosen on these too: without it a policy loses games that it was trained on
LEAST: Final = 1e-9  # judged chance
APART: Final = 0.2  # s, by which plans of the same blocks must differ ...
APART_SHARE: Final = 0.1  # ... and as a share of the later time

Floats = npt.NDArray[np.float64]
Judge = Callable[[Scene, Floats], Floats]
"""Of a scene and plans (N, S) s, NaN for never: the chance (N,) that each solves it."""


@dataclass(frozen=True, eq=False)
class PolicyTries:
    """An agent for `attempts`, blind or with feedback: it tries no plan that nearly repeats an earlier one.

    Where all of its samples do, it tries one that is no exact repeat; it repeats one if they were all tried.

    Played at the rate of the settings, its first plan is the greedy episode of the policy, step by step. With a judge,
    the greedy plan and samples are tried in the order of log chance + `policy_weight` * log probability. The greedy
    plan has `greedy_bonus` * probability more: a policy that is sure of its plan, as of a game that it was trained on,
    keeps it.

    Attributes:
        config: of the training of a policy in advance with the head "time_grid".
        state: of its algorithm.
        temperature: divides the logarithms of the probabilities; 1 samples as in training, more is more diverse.
        judge: what judges plans, such as `models.outcome.agent.judge_of`; None for no judge.
        policy_weight: of the policy's log probability beside the judge's log chance.
        greedy_bonus: of the greedy plan, times the policy's probability of it.
    """

    config: TrainConfig
    state: State
    temperature: float = TEMPERATURE
    judge: Judge | None = None
    policy_weight: float = POLICY_WEIGHT
    greedy_bonus: float = GREEDY_BONUS

    def __post_init__(self) -> None:
        check_positive("temperature", self.temperature)
        check_least("policy_weight", self.policy_weight, 0)
        check_least("greedy_bonus", self.greedy_bonus, 0)
        if self.config.strategy != "in-advance" or self.config.head != "time_grid":
            got = f"{self.config.strategy}, {self.config.head}"
            raise ValueError(f"config: expected a policy in advance with the head time_grid, got {show(got)}")
        if not isinstance(algorithm(self.config), ActorCritic):
            raise ValueError(f"config: expected ppo or a2c, got {show(self.config.agent)}")

    @default_options()
    def __call__(self, scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
        """Propose k plans, (k, S) s; without a judge the first of all is the greedy one."""
        agent = algorithm(self.config)
        assert isinstance(agent, ActorCritic)  # noqa: S101 - only its agents have the head
        obs = start_observations(self.config.strategy, self.config.observation, [scene])
        distribution = distributions(agent, self.state, obs)
        greedy = agent.head.mode(distribution)

        def sample(count: int) -> jax.Array:
            return warm_samples(agent, distribution, self.temperature, count, rng)

        def plans_of(raw_actions: jax.Array) -> Floats:
            return self._seconds(agent.head.action(raw_actions), scene)

        tried = [attempt.times for attempt in past]
        if self.judge is not None:
            drawn = jnp.concatenate([greedy, sample(JUDGED)])
            log_prob = agent.head.log_prob(jnp.repeat(distribution, len(drawn), axis=0), drawn, slot_mask(obs))
            ranked = self._ranked(scene, plans_of(drawn), np.asarray(log_prob, np.float64))
        for _ in range(k):
            plans = ranked if self.judge is not None else plans_of(sample(SAMPLES) if tried else greedy)
            tried.append(plans[_untried(plans, tried)])
        return np.array(tried[len(past) :])

    def _ranked(self, scene: Scene, plans: Floats, log_prob: Floats) -> Floats:
        """Plans (N, S) s, the best first, with the policy's log probabilities (N,); the greedy one was the first."""
        assert self.judge is not None  # noqa: S101 - else there is nothing to rank by
        chance = self.judge(scene, plans + 0.5 / self.config.fps)  # it sees the steps' own times
        score = np.log(np.maximum(chance, LEAST)) + self.policy_weight * log_prob
        score[0] += self.greedy_bonus * np.exp(log_prob[0])
        return plans[np.argsort(-score, kind="stable")]

    def _seconds(self, actions: jax.Array, scene: Scene) -> Floats:
        """Actions (B, 6) as plans of the scene's blocks, (B, S) s, NaN for never.

        The rule "simulate" takes the steps that the policy's environment takes.
        """
        steps = plan_to_steps(action_to_times(np.asarray(actions)), self.config.fps, "in_advance")
        return steps_to_times(steps[:, : len(scene.eliminable_blocks)], self.config.fps)


@partial(jax.jit, static_argnums=0)
def distributions(agent: ActorCritic[Any], state: State, obs: jax.Array) -> jax.Array:
    """A policy's distributions over raw actions, (S, ...), for observations (S, D)."""
    return agent.distribution(state.params, obs)


def warm_samples(
    agent: ActorCritic[Any], distribution: jax.Array, temperature: float, count: int, rng: np.random.Generator
) -> jax.Array:
    """Raw actions from distributions (S, ...) at a temperature, `count` of each in a row, (S * count, ...)."""
    warm = jnp.repeat(jax.nn.log_softmax(distribution / temperature), count, axis=0)
    return agent.head.sample(jax.random.key(int(rng.integers(MAX_SEED))), warm)


def _untried(plans: Floats, tried: Sequence[Floats]) -> int:
    """Return the first of plans (N, S) that differs from all tried ones, else the first that is no repeat, else 0."""
    for unlike in (differs, _is_other):
        new = np.all([unlike(plans, plan) for plan in tried], axis=0) if tried else np.ones(len(plans), bool)
        if new.any():
            return int(new.argmax())
    return 0


def _is_other(plans: Floats, plan: Floats) -> npt.NDArray[np.bool_]:
    """Return which plans (N, S) are not the very same as one (S,)."""
    return np.asarray(((plans != plan) & ~(np.isnan(plans) & np.isnan(plan))).any(axis=1))


def differs(plans: Floats, plan: Floats) -> npt.NDArray[np.bool_]:
    """Return which plans (N, S) differ from one (S,): in a block, or in a time by over 0.2 s and over 10 %."""
    other_blocks = np.isnan(plans) != np.isnan(plan)
    apart = np.abs(plans - plan)  # NaN where a block stays: never apart
    other_times = (apart > APART) & (apart > APART_SHARE * np.fmax(plans, plan))
    return np.asarray((other_blocks | other_times).any(axis=1))
