"""What every algorithm is: pure functions of static settings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optax

from iphyre_jax.train.algos.distributions import Head, action_head
from iphyre_jax.train.algos.networks import Params, network
from iphyre_jax.train.collect import PolicyFn, PolicyOutput, Trajectory
from iphyre_jax.train.hazard import Hazard, no_hazard
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.run import TrainConfig

S = TypeVar("S")
F = TypeVar("F", bound=Callable[..., Any])
State = Any  # a NamedTuple of the algorithm's own
Metrics = dict[str, jax.Array]


def jitted(*static: int) -> Callable[[F], F]:
    """`jax.jit` with static arguments that keeps the types of a method."""

    def jit(method: F) -> F:
        return cast(F, jax.jit(method, static_argnums=static))

    return jit


@dataclass(frozen=True)
class Algorithm(ABC, Generic[S]):
    """An algorithm with its settings.

    Shapes: B observations, D numbers in an observation, S scenes.

    Attributes:
        config: of the run; its seed is 0, for nothing here depends on it.
        settings: its settings of the algorithm.
        METRICS: names of what `learn` reports.
    """

    config: TrainConfig
    settings: S

    METRICS: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """The state before the first update; observations (S, D) of the training games give sizes and centre."""

    @abstractmethod
    def sample_action(self, state: State, key: jax.Array, obs: jax.Array, num_samples: int = 1) -> PolicyOutput:
        """Sample actions to learn from: `num_samples` for each observation (B, D), one observation after the other."""

    @abstractmethod
    def greedy(self, state: State, obs: jax.Array) -> jax.Array:
        """The action that the policy prefers for each observation (B, D)."""

    def median(self, state: State, obs: jax.Array, hazard: Hazard) -> tuple[jax.Array, Hazard]:
        """On the fly: the preferred actions (B,) at observations (B, D) after what came before them in their episodes.

        Policies that are drawn from act at the median of their time; here, those that are not act at once.
        """
        return self.greedy(state, obs), hazard

    def greedy_policy(self, state: State) -> Callable[[jax.Array], jax.Array]:
        """The preferred actions of whole episodes: call it with their observations (B, D), decision after decision.

        On the fly that is `median`, else `greedy`.
        """
        if self.config.strategy != "on-the-fly":
            return lambda obs: self.greedy(state, obs)
        return _MedianPolicy(self, state)

    @abstractmethod
    def inference_state(self, state: State) -> State:
        """The state without what only `learn` reads."""

    @abstractmethod
    def learn(self, state: State, key: jax.Array, trajectory: Trajectory, num_scenes: int) -> tuple[State, Metrics]:
        """Learn from the episodes of an update; the new state and metrics."""

    @property
    def head(self) -> Head:
        """The action head."""
        return action_head(self.config.head)

    def network(self, shape: tuple[int, ...], scale: float, *, dueling: bool = False) -> nn.Module:
        """A network with outputs of a shape."""
        return network(self.config, shape, scale, dueling=dueling)


class _MedianPolicy:
    """Acts at the median of the time until the next removal; it keeps the hazard of its episodes."""

    def __init__(self, agent: Algorithm[Any], state: State) -> None:
        self._agent, self._state = agent, state
        self._hazard: Hazard | None = None

    def __call__(self, obs: jax.Array) -> jax.Array:
        """(B,) int32 actions for the next observations (B, D)."""
        hazard = no_hazard(slot_mask(obs)) if self._hazard is None else self._hazard
        action, self._hazard = self._agent.median(self._state, obs, hazard)
        return action


def forward(module: nn.Module, params: Params, obs: jax.Array) -> jax.Array:
    """The outputs of a network."""
    return cast(jax.Array, module.apply(params, obs))


def descend(
    optimizer: optax.GradientTransformation, gradient: Params, params: Params, opt_state: optax.OptState
) -> tuple[Params, optax.OptState]:
    """Make one step of an optimiser: the new parameters and its new state."""
    changes, opt_state = optimizer.update(gradient, opt_state, params)
    return optax.apply_updates(params, changes), opt_state


def without_value(action: jax.Array, raw_action: jax.Array) -> PolicyOutput:
    """The output of a policy whose learner needs neither log-probabilities nor values."""
    zero = jnp.zeros(action.shape[0], jnp.float32)
    return PolicyOutput(action, raw_action, zero, zero)


def preferring(greedy: Callable[[jax.Array], jax.Array]) -> PolicyFn:
    """A policy of preferred actions, those that `greedy` gives for observations (B, D)."""

    def policy(key: jax.Array, obs: jax.Array, num_samples: int) -> PolicyOutput:
        del key
        action = jnp.repeat(greedy(obs), num_samples, axis=0)
        return without_value(action, action)

    return policy


def preferring_where(
    chosen: npt.NDArray[np.bool_], greedy: Callable[[jax.Array], jax.Array], sample: PolicyFn
) -> PolicyFn:
    """A policy of sampled actions, and of preferred ones in the episodes (B,) that are chosen."""

    def policy(key: jax.Array, obs: jax.Array, num_samples: int) -> PolicyOutput:
        sampled = sample(key, obs, num_samples)
        best = jnp.repeat(greedy(obs), num_samples, axis=0)
        is_chosen = jnp.asarray(chosen.reshape(-1, *(1,) * (best.ndim - 1)))
        return sampled._replace(action=jnp.where(is_chosen, best, sampled.action))

    return policy


def global_norm(tree: Params) -> jax.Array:
    """() Euclidean norm of all numbers of a tree of arrays (optax renamed its own between our versions of it)."""
    return jnp.sqrt(sum((jnp.square(leaf).sum() for leaf in jax.tree.leaves(tree)), jnp.zeros(())))


def active_first(key: jax.Array, weight: jax.Array) -> jax.Array:
    """(N,) indices of rows in random order, those of weight (N,) 1 or True before those of 0 or False."""
    return jnp.argsort(jax.random.uniform(key, weight.shape, jnp.float32) + (1.0 - weight))


def masked_mean(values: jax.Array, weight: jax.Array) -> jax.Array:
    """() mean of the values of weight 1; 0 if there are none."""
    return (values * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def not_finite(state: State) -> str:
    """Return the name of the first array of a state that holds NaN or infinity; empty if there is none."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(state):
        if jnp.issubdtype(leaf.dtype, jnp.floating) and not np.isfinite(np.asarray(leaf)).all():
            return jax.tree_util.keystr(path, simple=True, separator=".")
    return ""
