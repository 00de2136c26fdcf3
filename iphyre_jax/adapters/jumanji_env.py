"""One world as a `jumanji.env.Environment`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jumanji import specs
from jumanji.env import Environment as JumanjiEnvironment
from jumanji.types import StepType, TimeStep, restart

from iphyre_jax.adapters.arguments import refuse_options
from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.envs import EnvState, make
from iphyre_jax.envs.spaces import Discrete


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class JumanjiState:
    """A world and the key that jumanji's wrappers begin its next episode with.

    Attributes:
        key: random key, of the kind that `reset` was given.
        env_state: the world.
    """

    key: jax.Array
    env_state: EnvState


class JumanjiEnv(JumanjiEnvironment[JumanjiState, specs.Array, jax.Array]):
    """One world as a `jumanji.env.Environment`, for jumanji's own wrappers, which map and reset it.

    Every episode is one of the id's games, drawn with the key. The discount is 0 where an episode ends by itself, which
    an in-advance one always does, and 1 where time cuts it. The extras are those of `iphyre_jax.envs.Environment.info`.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        **options: as for `iphyre_jax.make`, except autoreset.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    def __init__(self, id: str, **options: Any) -> None:  # noqa: ANN401
        refuse_options(options, ("autoreset",), ", because jumanji's wrapper resets")
        self.env, self.params = make(id, autoreset=False, **options)
        super().__init__()

    def reset(self, key: jax.Array) -> tuple[JumanjiState, TimeStep]:
        """Begin an episode."""
        own, later = jax.random.split(key)
        obs, state = self.env.reset(own, self.params)
        first = restart(obs, extras=self.env.info(state, self.params), dtype=jnp.float32)
        return JumanjiState(later, state), first

    def step(self, state: JumanjiState, action: jax.Array) -> tuple[JumanjiState, TimeStep]:
        """Play one decision."""
        unused = jax.random.key(0)  # without autoreset nothing is random
        obs, after, reward, *official, info = self.env.step(unused, state.env_state, action, self.params)
        terminated, truncated = gymnasium_flags(self.env, *official)
        step_type = jnp.where(terminated | truncated, StepType.LAST, StepType.MID)
        discount = 1.0 - terminated.astype(jnp.float32)
        moment = TimeStep(step_type=step_type, reward=reward, discount=discount, observation=obs, extras=info)
        return JumanjiState(state.key, after), moment

    @cached_property
    def observation_spec(self) -> specs.Array:
        """The specification of an observation."""
        space = self.env.observation_space()
        if not np.isfinite([space.low, space.high]).all():
            return specs.Array(space.shape, space.dtype, "observation")
        return specs.BoundedArray(space.shape, space.dtype, space.low, space.high, "observation")

    @cached_property
    def action_spec(self) -> specs.Array:
        """The specification of an action."""
        space = self.env.action_space()
        if isinstance(space, Discrete):
            return specs.DiscreteArray(space.n, jnp.int32, "action")
        return specs.BoundedArray(space.shape, space.dtype, space.low, space.high, "action")
