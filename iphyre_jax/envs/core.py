"""The environment: pure functions of keys, states, actions and parameters, in the shape that gymnax has today.

    obs, state = env.reset(key, params)
    obs, state, reward, terminated, truncated, info = env.step(key, state, action, params)

All of them are written for one world; `jax.vmap` makes a batch of any mixture of the parameters' games.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from iphyre_jax.envs.features import Features, motion, motion_size, official_rows, own_features, rows_size, standing
from iphyre_jax.envs.mixture import Games, Mixture
from iphyre_jax.envs.params import EnvParams, EnvState, SceneLike, make_params, row
from iphyre_jax.envs.protocols import Protocol
from iphyre_jax.envs.spaces import Box, Space
from iphyre_jax.envs.strategies import Ending, Strategy
from iphyre_jax.envs.stretches import Stretch
from iphyre_jax.physics.types import World
from iphyre_jax.reward import ELIMINATION_REWARD, SECOND_REWARD, SUCCESS_REWARD
from iphyre_jax.rollouts import Outcome, Progress
from iphyre_jax.scenes import Limits, load_scenes
from iphyre_jax.scenes.build import timing
from iphyre_jax.scenes.limits import OFFICIAL

ObservationName = Literal["official", "motion", "image"]
Info = dict[str, Any]
Tree = TypeVar("Tree")


@dataclass(frozen=True)
class Environment:
    """A strategy over games of some topologies; hashable, hence static under `jax.jit`.

    Two that differ in their names alone are equal, and what is compiled for one serves the other.

    Attributes:
        name: its id, if it has one.
        games: names of its games, in the order of the parameters that `make` returns with it.
        strategy: how actions become removals.
        protocol: physics steps under the decisions.
        mixture: topologies that the parameters may hold.
        dtype: of the physics, "float32" or "float64".
        observation: "official", the twelve rows and the candidates, float32 in [0, 1]; "motion", the same with
            velocities and time, Markov but for the solver's cached impulses; "image", (size, size, 3) uint8.
        image_size: px, side of an image; 0 without images.
        autoreset: whether an episode that has ended is followed by a new one in the same step.
        limits: of its scenes, the official ones or larger: rows of an observation, slots of the strategy.
    """

    name: str = field(compare=False)
    games: tuple[str, ...] = field(compare=False)
    strategy: Strategy
    protocol: Protocol
    mixture: Mixture
    dtype: str = "float32"
    observation: ObservationName = "official"
    image_size: int = 0
    autoreset: bool = True
    limits: Limits = OFFICIAL

    def params(self, scenes: tuple[SceneLike, ...] | list[SceneLike]) -> EnvParams:
        """Return parameters of other games of the same topologies.

        Args:
            scenes: names, files or scenes; an episode begins with one of them at random.

        Raises:
            ValueError: no scenes, a bad one, or one of another topology; one line.
            OSError: a scene file cannot be read.
        """
        return make_params(load_scenes(scenes, self.limits), self.mixture, self.protocol, self.dtype)

    def alone(self, params: EnvParams, game: int) -> tuple[Environment, EnvParams]:
        """Return the environment and parameters of one game, with the same spaces; nothing else is compiled (host).

        Args:
            params: the games.
            game: row of the parameters.
        """
        kind = int(params.table.kind[game])
        topology, of = self.mixture.topologies[kind], self.mixture.only(kind)
        with jax.enable_x64(self.dtype == "float64"):
            tables = params.world, params.start, params.features
            world, start, features = jax.tree.map(lambda leaf: np.asarray(leaf)[game], tables)
            own = of.world.cut(world), of.progress.cut(start), own_features(features, topology)
            world, start, features = jax.tree.map(lambda leaf: jnp.asarray(leaf[None]), own)
            table = Games(world, jnp.zeros(1, jnp.int32))
        return replace(self, games=self.games[game : game + 1], mixture=of), EnvParams(table, start, features)

    @partial(jax.jit, static_argnums=0)
    def reset(self, key: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        """Begin an episode of one of the games, each as probable as the others.

        Args:
            key: random key, typed (`jax.random.key`) or not (`jax.random.PRNGKey`).
            params: the games.

        Returns:
            The observation (see `observation_space`) and the state.
        """
        return self.reset_to(jax.random.randint(key, (), 0, params.games, jnp.int32), params)

    @partial(jax.jit, static_argnums=0)
    def reset_to(self, game: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        """Begin an episode of a given game.

        Args:
            game: () int32, row of the parameters.
            params: the games.

        Returns:
            As `reset`.
        """
        self.check_dtype()
        state = EnvState(row(params.start, game), jnp.asarray(game, jnp.int32), jnp.zeros(self.strategy.slots, bool))
        return self.observe(state, params), state

    def step(
        self, key: jax.Array, state: EnvState, action: ArrayLike, params: EnvParams
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        """Play one decision.

        Without autoreset an episode that has ended stays as it is, with a reward of 0 and the same flags.

        Args:
            key: random key for the game that follows under autoreset.
            state: of the episode.
            action: a member of `action_space`; numbers beyond it, NaN included, do nothing.
            params: the games.

        Returns:
            The observation, the state, the reward (() float32: 1000 if solved, -10 a removed block, -1 a second), the
            official flags terminated and truncated (() bool) and the info of the transition: `info` of the state before
            any reset.

        Raises:
            ValueError: the action has another shape or type than the space, or JAX not the physics' type; one line.
        """
        self.check_dtype()
        out: tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]
        out = self._step(key, state, self.action_space().array(action), params)
        return out

    @partial(jax.jit, static_argnums=0)
    def _step(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        after, reward = self._play(state, action, params)
        ending = self.ending(after.progress)
        info = self.info(after, params)
        if self.autoreset:
            fresh = self.reset(key, params)
            done = ending.terminated | ending.truncated
            going = info["final_observation"], after
            seen, after = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, going)
            return seen, after, reward, *ending, info
        return info["final_observation"], after, reward, *ending, info

    @partial(jax.jit, static_argnums=0)
    def observe(self, state: EnvState, params: EnvParams) -> jax.Array:
        """Return what an agent sees of a state."""
        return self.view(row(params.features, state.game), row(params.world, state.game), state.progress)

    def view(self, features: Features, world: World, progress: Progress) -> jax.Array:
        """Return what an agent sees of a world; of worlds in lanes, trailing axes, lanes of observations."""
        if self.observation == "image":
            from iphyre_jax.envs.images import image

            draw = partial(image, size=self.image_size)
            for _ in range(progress.state.step.ndim):
                draw = jax.vmap(draw, in_axes=-1, out_axes=-1)
            return draw(features, world, progress)
        lanes = progress.state.step.shape
        seen = [official_rows(features, world, progress)]
        if self.strategy.no_op_candidate:
            seen.append(jnp.zeros((2, *lanes), jnp.float32))
        seen.append(features.candidates.reshape(-1, *lanes))
        if self.observation == "motion":
            seen.append(motion(features, progress, self.protocol))
        return jnp.concatenate(seen)

    def info(self, state: EnvState, params: EnvParams) -> Info:
        """Return what there is to know of a state beside its observation; the tree of `step` and after `reset` alike.

        Returns:
            success, () bool; fault, () int32, 0 for a sound world (see `iphyre_jax.rollouts`); eliminations, () int32,
            blocks removed; time, () float32, seconds played; game, () int32, row of the parameters; final_observation,
            what an agent sees of this state.
        """
        return {
            **self.counters(state.progress.outcome),
            "game": state.game,
            "final_observation": self.observe(state, params),
        }

    def counters(self, outcome: Outcome) -> Info:
        """Return the numbers of `info` that come from the physics alone."""
        return {
            "success": outcome.success,
            "fault": outcome.fault,
            "eliminations": outcome.eliminations,
            "time": outcome.steps.astype(jnp.float32) / self.protocol.fps,
        }

    def action_space(self, params: EnvParams | None = None) -> Space:
        """Return the space of actions, the same for all games."""
        del params
        return self.strategy.action_space()

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Return the space of observations, the same for all games."""
        del params
        if self.observation == "image":
            return Box(0, 255, (self.image_size, self.image_size, 3), "uint8")
        objects = self.limits.objects
        size = rows_size(objects) + 2 * (self.strategy.slots + self.strategy.no_op_candidate)
        if self.observation == "motion":
            return Box(float("-inf"), float("inf"), (size + motion_size(objects),))
        return Box(0.0, 1.0, (size,))

    @property
    def num_actions(self) -> int:
        """Number of actions of a discrete strategy, length of an action of the others."""
        space = self.strategy.action_space()
        return space.shape[0] if isinstance(space, Box) else space.n

    def _play(self, state: EnvState, action: jax.Array, params: EnvParams) -> tuple[EnvState, jax.Array]:
        """Play one decision; an episode that has ended stays as it is."""
        world, before = row(params.world, state.game), state.progress
        blocks = standing(world, before, self.strategy.slots)
        order = self.strategy.order(action, before.state.step, state.used, blocks, self.protocol)
        ended = self.has_ended(before)
        until = jnp.where(ended, before.state.step, order.until)
        stretch = Stretch(state.game, order.plan, until)
        times, games = _opaque((timing(self.protocol.fps, self.dtype), params.table))
        progress = self.mixture.play(times, games, stretch, before)
        used = jnp.where(ended, state.used, order.used)
        return replace(state, progress=progress, used=used), self.reward(before.outcome, progress.outcome)

    def reward(self, before: Outcome, after: Outcome) -> jax.Array:
        """Return the reward of what lies between two outcomes of an episode, () float32."""
        solved = (after.success & ~before.success).astype(jnp.float32)
        removed = (after.eliminations - before.eliminations).astype(jnp.float32)
        seconds = (after.steps - before.steps).astype(jnp.float32) / self.protocol.fps
        return SUCCESS_REWARD * solved + (ELIMINATION_REWARD * removed + SECOND_REWARD * seconds)

    def ending(self, progress: Progress) -> Ending:
        """Return the official flags of an episode as it stands."""
        outcome = progress.outcome
        stopped = (progress.state.step >= self.protocol.steps) | (outcome.fault != 0)
        return self.strategy.ending(outcome.success, stopped)

    def has_ended(self, progress: Progress) -> jax.Array:
        """Return whether an episode has ended, () bool."""
        ending = self.ending(progress)
        return ending.terminated | ending.truncated

    def check_dtype(self) -> None:
        """Raise ValueError, one line, where JAX does not have the physics' dtype."""
        if jax.dtypes.canonicalize_dtype(self.dtype) != self.dtype:
            raise ValueError('dtype: expected jax.enable_x64(True) around an environment of dtype "float64"')


def _opaque(tree: Tree) -> Tree:
    """Return arrays out of the compiler's sight: what it does with constants rounds otherwise."""
    return jax.lax.optimization_barrier(jax.tree.map(jnp.asarray, tree))
