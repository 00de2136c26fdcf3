"""One world as a `brax.envs.Env`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import Env, State

from iphyre_jax.adapters.arguments import refuse_options
from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.envs import make
from iphyre_jax.envs.spaces import Box


def mend_brax() -> None:
    """Add a function to JAX that brax 0.14.2 calls and JAX 0.10 has dropped, so that brax's trainers run.

    `jax.device_put_replicated` puts a tree on devices, stacked once for each. If JAX has it, nothing changes.
    """

    def device_put_replicated(x: Any, devices: Sequence[jax.Device]) -> Any:  # noqa: ANN401
        return jax.device_put(jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), x))

    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = device_put_replicated


class BraxEnv(Env):
    """One world as a `brax.envs.Env`, for brax's own wrappers, which map and reset it.

    Brax's policies give numbers from -1 to 1. In advance and combined, six numbers a give the shares of 15 s,
    (a + 1) / 2; on the fly, the largest of seven numbers selects the action. Brax's wrappers need old-style random keys
    (`jax.random.PRNGKey`), and its `AutoResetWrapper` starts all episodes of a world with the game of the first.
    `mend_brax` makes brax's trainers run on newer versions of JAX.

    state.pipeline_state is the `EnvState`; metrics has success; info has terminated and truncated by gymnasium's
    definition, 0 or 1. done, reward, metrics and info are of JAX's default float, as brax's own are. In brax the time
    limit is the wrapper's: give `episode_length=150` on the fly, so that its `EpisodeWrapper` ends an episode and says
    so in `info["truncation"]`. There done is 1 where terminated, and one decision after the limit or a fault. Combined
    episodes have no fixed number of decisions: done is 1 where terminated or truncated.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        **options: as for `iphyre_jax.make`, except autoreset.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    def __init__(self, id: str, **options: Any) -> None:  # noqa: ANN401
        refuse_options(options, ("autoreset",), ", because brax's wrapper resets")
        self.env, self.params = make(id, autoreset=False, **options)
        self._on_the_fly = self.env.strategy.name == "on-the-fly"
        self._actions = Box(-1.0, 1.0, (self.action_size,))

    def reset(self, rng: jax.Array) -> State:
        """Begin an episode."""
        obs, state = self.env.reset(rng, self.params)
        zero = _number(0)
        return State(state, obs, zero, zero, metrics={"success": zero}, info={"terminated": zero, "truncated": zero})

    def step(self, state: State, action: jax.Array) -> State:
        """Play one decision.

        Raises:
            ValueError: the action has another shape or is not numeric; one line.
        """
        given = self._actions.array(action)
        # Of NaN argmax is the first one, which would remove a block; 0 removes nothing.
        preferred = jnp.where(jnp.isnan(given).any(), 0, jnp.argmax(given)).astype(jnp.int32)
        own = preferred if self._on_the_fly else ((given + 1) / 2).clip(0.0, 1.0)
        key = jax.random.key(0)  # without autoreset nothing is random
        out = self.env.step(key, state.pipeline_state, own, self.params)
        obs, after, reward, *official, info = out
        terminated, truncated = gymnasium_flags(self.env, *official)
        before = self.env.worlds.status(self.params, state.pipeline_state)
        late = self.env.has_ended(before) if self._on_the_fly else truncated
        return state.replace(
            pipeline_state=after,
            obs=obs,
            reward=_number(reward),
            done=_number(terminated | late),
            metrics=state.metrics | {"success": _number(info["success"])},
            info=state.info | {"terminated": _number(terminated), "truncated": _number(truncated)},
        )

    @property
    def observation_size(self) -> int | tuple[int, ...]:
        """The length of an observation; its shape if it is an image."""
        shape = self.env.observation_space().shape
        return shape[0] if len(shape) == 1 else shape

    @property
    def action_size(self) -> int:
        """The length of an action."""
        return self.env.num_actions

    @property
    def backend(self) -> str:
        """The name of the solver, which is not one of brax's."""
        return "iphyre_jax"


def _number(value: jax.typing.ArrayLike) -> jax.Array:
    """Return a number as brax's wrappers make theirs, float64 under x64; another type ends their scans."""
    return jnp.asarray(value, float)
