"""An outcome classifier as an agent: it judges random plans and plays those that it believes in most."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.agents import unrepeated
from iphyre_jax.attempts.metrics import solved_curve
from iphyre_jax.attempts.planner import best_plans
from iphyre_jax.attempts.protocol import Agent, Attempt
from iphyre_jax.checks import check_plans, check_whole
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.models.outcome.plays.augmented import padded_random_plans
from iphyre_jax.models.outcome.plays.inputs import plan_inputs, scene_inputs
from iphyre_jax.models.outcome.storage import OutcomeClassifier
from iphyre_jax.models.outcome.training import predict_for
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import MAX_ELIMINABLE, SceneLike, load_scene
from iphyre_jax.simulation import simulate_many

CANDIDATES: Final = 1000  # plans that are judged
MOST: Final = 100_000
FPS: Final = 60

Floats = npt.NDArray[np.float64]


def candidates(blocks: int, count: int, rng: np.random.Generator) -> Floats:
    """Different random plans of the official distribution, at most `count`, (C, 6) s; NaN for a block that stays."""
    drawn = padded_random_plans(blocks, count, rng)
    return drawn[unrepeated(drawn)]


def judge_of(classifier: OutcomeClassifier) -> Callable[[SceneLike, Floats], Floats]:
    """How a trained classifier judges plans, for `attempts.policy_tries.PolicyTries`.

    Returns:
        A function of a scene and plans (N, S) s, NaN for a block that stays, which gives the chance (N,) that each
        solves the scene.
    """
    config = classifier.config

    @default_options()
    def judge(scene: SceneLike, plans: Floats) -> Floats:
        loaded = load_scene(scene)
        plans = check_plans(plans, len(loaded.eliminable_blocks), MAX_ELIMINABLE)
        columns = np.full((len(plans), MAX_ELIMINABLE), np.nan)
        columns[:, : plans.shape[1]] = plans
        seen = jax.device_put(scene_inputs([loaded], config))
        inputs = plan_inputs([loaded], np.zeros(len(plans), np.int32), columns, config)
        return predict_for(config, classifier.params, seen, inputs)[0]

    return judge


def ranking_agent(classifier: OutcomeClassifier, count: int = CANDIDATES) -> Agent:
    """An agent that plays the k best of `count` random plans, as a trained classifier judges them.

    Returns:
        A function of scene, k, a NumPy generator and, which it does not read, earlier attempts; it gives plans,
        (k, blocks) s, NaN for a block that stays. If k exceeds the number of different plans, the best come again.
    """
    judge = judge_of(classifier)
    check_whole("count", count, 1, MOST)

    def propose(scene: SceneLike, k: int, rng: np.random.Generator, past: Sequence[Attempt] = ()) -> Floats:
        del past
        loaded = load_scene(scene)
        blocks = len(loaded.eliminable_blocks)
        plans = candidates(blocks, count, rng)
        return best_plans(plans, judge(loaded, plans)[None], check_whole("k", k))[:, :blocks]

    return propose


def solved_within(agent: Agent, games: Sequence[str], k: int, repeats: int, seed: int = 0) -> Floats:
    """Let an agent try each game k times, at 60 steps a second, in float64 and a fresh space.

    Args:
        agent: it is shown no earlier attempts.
        games: to play.
        k: attempts.
        repeats: of each game, with other random plans.
        seed: of the generators.

    Returns:
        (G, k): share of the repeats that have solved the game within 1, 2, ..., k attempts.
    """
    scenes = [load_scene(game) for game in games]
    plans = np.full((len(games), repeats, k, 6), np.nan)
    for index, scene in enumerate(scenes):
        for repeat in range(repeats):
            proposed = np.asarray(agent(scene, k, np.random.default_rng([seed, index, repeat]), ()))
            plans[index, repeat, :, : proposed.shape[1]] = proposed
    which = np.repeat(np.arange(len(games)), repeats * k)
    steps = plan_to_steps(plans.reshape(-1, 6), FPS, "simulate")
    success = simulate_many(scenes, which, steps, fps=FPS, dtype="float64").success.reshape(len(games), repeats, k)
    return solved_curve(success)
