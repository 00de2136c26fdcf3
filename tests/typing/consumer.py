"""The public surface as a typed program of a user sees it. Checked by mypy in `make lint`, never run.

`assert_type` fails where a public name has lost its type: one that is missing from the TYPE_CHECKING block of
`iphyre_jax/__init__.py` is an `object` to mypy, though it works.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, assert_type

import jax
import numpy as np
import numpy.typing as npt
from rich.console import Console

import iphyre_jax
from iphyre_jax import Configuration, Environment, EnvParams, EnvState, Limits, Scene, SceneBuilder, Scores, Simulation
from iphyre_jax.adapters import (
    FiveValues,
    GymnasiumEnv,
    GymnasiumVectorEnv,
    GymnaxEnv,
    register_gymnasium,
    register_gymnax,
)
from iphyre_jax.compat import GAMES, IPHYRE, MAX_ELI_OBJ_NUM, MAX_OBJ_NUM, generate_actions
from iphyre_jax.envs import Batch, Box, Discrete, Steps, unroll
from iphyre_jax.physics import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeResult
from iphyre_jax.scenes import ObjectRef, Variations
from iphyre_jax.train.evaluate import Evaluation
from iphyre_jax.train.evaluate import evaluate as evaluate_agent
from iphyre_jax.train.loop import resume, train
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.settings.run import TrainConfig, preset
from iphyre_jax.train.storage.pretrained import Pretrained, load_pretrained
from iphyre_jax.viewer.films import save
from iphyre_jax.viewer.frames import Look
from iphyre_jax.viewer.recording import Recording, record


def scenes() -> Scene:
    assert_type(iphyre_jax.__version__, str)
    assert_type(iphyre_jax.GAMES, tuple[str, ...])
    assert_type(iphyre_jax.SPLITS, Mapping[str, tuple[str, ...]])
    limits = assert_type(Limits(20, 10), Limits)
    builder = assert_type(SceneBuilder("two shelves", limits), SceneBuilder)
    assert_type(builder.block((200, 400), (300, 400), eliminable=True), ObjectRef)
    assert_type(builder.ball((250, 340), radius=20), ObjectRef)
    assert_type(iphyre_jax.vary(builder.build(), 7, jitter_px=20), Variations)
    scene = assert_type(iphyre_jax.load_scene("hole"), Scene)
    assert_type(scene.eliminable_blocks, tuple[int, ...])
    return scene


def simulations(scene: Scene) -> None:
    steps = assert_type(iphyre_jax.plan_to_steps([[0.5, np.nan]], fps=60, rule="simulate"), npt.NDArray[np.int64])
    played = assert_type(iphyre_jax.simulate(scene, steps, fps=60), Simulation)
    assert_type(played.reward, npt.NDArray[np.float64])
    assert_type(played.success, npt.NDArray[np.bool_])
    assert_type(iphyre_jax.simulate_many(["hole", scene], [0, 1], steps, share_prefixes=True), Simulation)
    assert_type(iphyre_jax.configure(devices=2, cache=False), Configuration)


def lanes(topology: Topology, world: World, timing: Timing, plan: jax.Array) -> None:
    assert_type(iphyre_jax.rollout(topology, world, timing, plan, plan[0]), EpisodeResult)


def environments(scene: Scene) -> None:
    assert_type(iphyre_jax.environment_ids(), tuple[str, ...])
    iphyre_jax.register("mine-v1", [scene])
    env, params = iphyre_jax.make("on-the-fly/hole-v1", autoreset=False, limits=Limits(20, 10))
    assert_type(env, Environment)
    assert_type(params, EnvParams)
    assert_type(env.action_space(), Box | Discrete)
    assert_type(env.observation_space(), Box)
    key = jax.random.key(0)
    state: EnvState
    _, state = env.reset(key, params)  # `jax.jit` gives `reset` and `unroll` the type Any
    seen, state, reward, terminated, truncated, info = env.step(key, state, 1, params)
    assert_type(state, EnvState)
    assert_type((seen, reward, terminated, truncated), tuple[jax.Array, jax.Array, jax.Array, jax.Array])
    assert_type(info, dict[str, Any])
    batch = assert_type(Batch.of(env, params, [0, 0]), Batch)

    def policy(weights: Any, key: jax.Array, seen: jax.Array) -> tuple[jax.Array, Any]:
        return jax.random.categorical(key, seen @ weights), ()

    steps: Steps
    batch, steps = unroll(env, policy, np.zeros((122, 7)), batch, key, decisions=32)
    assert_type(steps.reward, jax.Array)
    scores = iphyre_jax.evaluate(lambda key, seen: seen[:6], "basic", strategy="in-advance", episodes=2)
    assert_type(scores, Scores)
    assert_type(scores.mean_reward, float)


def adapters() -> None:
    assert_type(register_gymnasium(), tuple[str, ...])
    assert_type(GymnasiumEnv("in-advance/hole-v1"), GymnasiumEnv)
    assert_type(GymnasiumVectorEnv("in-advance/hole-v1", 4), GymnasiumVectorEnv)
    assert_type(FiveValues(*iphyre_jax.make("in-advance/hole-v1")), FiveValues)
    assert_type(GymnaxEnv(*iphyre_jax.make("in-advance/hole-v1")), GymnaxEnv)
    assert_type(register_gymnax(), tuple[str, ...])


def official_names() -> None:
    assert_type((MAX_OBJ_NUM, MAX_ELI_OBJ_NUM), tuple[int, int])
    simulator = assert_type(IPHYRE(GAMES[0], fps=10), IPHYRE)
    assert_type(simulator.simulate([[360.0, 200.0, 1.0]]), tuple[int, int, float])
    generate_actions("support", 2, 2, 0.1, 15.0, 7.0, 6)


def viewers(scene: Scene) -> None:
    recording = assert_type(record(scene, [-1, -1, 83, 32]), Recording)
    save("hole.gif", recording, Look(theme="official", size=300, trails=True))


def agents() -> None:
    config = assert_type(preset("ppo", "in-advance"), TrainConfig)
    trained = train(config, Path("run"), Console())
    assert_type(evaluate_agent(config, trained.state.learner), Evaluation)
    resume(Path("run"), Console())
    policy = assert_type(load_pretrained("ppo-i"), Pretrained)
    seen = assert_type(start_observations("in-advance", "official", ["support"]), jax.Array)
    assert_type(policy.greedy(seen), jax.Array)
