"""Plans that are only imagined: rolled out in a world model, scored by the rules of the game."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.planner import best_plans, different_plans
from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.checks import check_plans, check_whole
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.models.world.interface import Predict, predictor, roll, start_memory, start_rows
from iphyre_jax.models.world.plays import EVERY, FIRST, FPS, removal_instants
from iphyre_jax.models.world.storage import WorldModel
from iphyre_jax.models.world.tables import SceneTables, scene_tables
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import FRAMES, GOAL_Y, episode_reward
from iphyre_jax.scenes import Scene, SceneLike, load_scene

LANES: Final = 100  # worlds that are rolled out at once
LOOKS: Final = FRAMES - 1  # predictions of an episode: the last is of the world after step 895, the next of 901
MOVERS, TIES = 3, 1  # least room in these worlds, so that most games share a program

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Imagined:
    """How N plans end in a world model.

    Attributes:
        success: (N,) bool.
        steps: (N,) int64, physics steps until then, or those of 15 s.
        eliminations: (N,) int64, blocks removed by then.
        reward: (N,) float64, points.
    """

    success: npt.NDArray[np.bool_]
    steps: npt.NDArray[np.int64]
    eliminations: npt.NDArray[np.int64]
    reward: Floats


def roll_out(
    predict: Predict, model: WorldModel, tables: SceneTables, which: npt.NDArray[np.int32], gone: npt.NDArray[np.int32]
) -> Imagined:
    """Roll out plans from the start of their scenes.

    Args:
        predict: of the model.
        model: its settings and parameters.
        tables: of the scenes.
        which: (N,) the scene of each plan.
        gone: (N, 12) instants of removals, as `removal_instants` gives them.
    """
    lowest = [
        _lowest(predict, model, tables, which[at : at + LANES], gone[at : at + LANES])
        for at in range(0, len(which), LANES)
    ]
    solved = np.concatenate([np.zeros((0, LOOKS)), *lowest]) > GOAL_Y
    success, first = np.asarray(solved.any(axis=1)), solved.argmax(axis=1)
    end = np.where(success, FIRST + EVERY * (first + 1), FPS * FRAMES // 10)
    removed = ((gone >= 0) & (gone * EVERY + FIRST < end[:, None])).sum(axis=1)
    reward = np.asarray(episode_reward(success, removed, end, FPS), np.float64)
    return Imagined(success, end.astype(np.int64), removed.astype(np.int64), reward)


def _lowest(
    predict: Predict, model: WorldModel, tables: SceneTables, which: npt.NDArray[np.int32], gone: npt.NDArray[np.int32]
) -> Floats:
    """The y of the highest ball after each prediction, (N, LOOKS); NaN never counts as solved."""
    count = len(which)
    index = np.resize(which, LANES)  # one program for all
    scene: SceneTables = jax.device_put(jax.tree.map(lambda table: np.asarray(table)[index], tables))
    removed = jax.device_put(np.resize(gone, (LANES, gone.shape[1])))
    memory, rows = start_memory(model.config, scene), start_rows(scene)
    centre = roll(predict, model.params, memory, rows, removed, LOOKS)
    height = jnp.where(jnp.asarray(scene.ball)[None], centre[..., 1], jnp.inf).min(axis=-1)
    return np.asarray(height, np.float64).T[:count]


class WorldImagination:
    """Imagines plans of a scene in a trained world model.

    Args:
        model: trained.
        predict: the model's prediction; by default of its settings.
    """

    def __init__(self, model: WorldModel, predict: Predict | None = None) -> None:
        self._model = model
        self._predict = predictor(model.config) if predict is None else predict

    @default_options()
    def imagined(self, scene: SceneLike, plans: npt.ArrayLike) -> Imagined:
        """How plans (N, S), s of the eliminable blocks and NaN for never, end in the model.

        Raises:
            ValueError: plans of another shape; one line.
        """
        loaded = load_scene(scene)
        times = check_plans(plans, len(loaded.eliminable_blocks))
        steps = plan_to_steps(times, FPS, "simulate")
        which = np.zeros(len(steps), np.int32)
        tables = scene_tables([loaded], MOVERS, TIES)
        return roll_out(self._predict, self._model, tables, which, removal_instants([loaded], which, steps))

    def __call__(self, scene: SceneLike, plans: npt.ArrayLike) -> Floats:
        """The rewards (N,) that plans (N, S) have in the model."""
        return self.imagined(scene, plans).reward


@dataclass(frozen=True)
class WorldPlanner:
    """An agent that draws random plans, imagines them in a world model and plays the best.

    Attributes:
        imagine: from scene and plans to rewards.
        plans: random plans that are drawn; the different ones are imagined.
    """

    imagine: WorldImagination
    plans: int = 300

    def __call__(self, scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
        """Propose the k best plans as `best_plans` gives them, of those that were not tried."""
        times = different_plans(rng, scene, check_whole("plans", self.plans, k), past)
        return best_plans(times, self.imagine(scene, times)[None], k)
