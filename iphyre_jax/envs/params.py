"""The data of an environment: its games, and the state of an episode; opaque to users, but for what is named."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, NamedTuple

import jax

from iphyre_jax.envs.batching.status import Status
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.observations.features import Features, Pose
from iphyre_jax.observations.vectors import ObservationName
from iphyre_jax.physics.types import Topology
from iphyre_jax.scenes import Limits, Scene

SceneLike = str | PathLike[str] | Scene


class EnvParams(ABC):
    """The games of an environment, one a row of every array; an episode begins with one of them at random."""

    @property
    @abstractmethod
    def games(self) -> int:
        """The number of games."""

    @property
    @abstractmethod
    def topology_id(self) -> jax.Array:
        """Topology of each game, (games,) int32, an index into those of the environment."""


class EnvState(ABC):
    """An episode of one game: a tree of arrays, each with an axis in front for a batch of episodes."""

    @property
    @abstractmethod
    def game(self) -> jax.Array:
        """Row of the parameters, () int32."""


class StepResult(NamedTuple):
    """One decision of an episode."""

    state: Any  # now; of the next episode if this one has ended
    obs: jax.Array  # of that state
    status: Status  # after the decision, of the episode that was played
    final_state: Any  # of the episode that was played; None if it was not asked for
    final_obs: jax.Array | None  # of that state


@dataclass(frozen=True)
class Worlds(ABC):
    """How episodes are begun, played and seen, for one world, to be mapped; see `host_worlds` and `traced_worlds`.

    Hashable. Attributes as of `Environment`; no_op: whether a candidate that does nothing is seen.
    """

    topologies: tuple[Topology, ...]
    dtype: str
    protocol: EpisodeProtocol
    observation: ObservationName
    limits: Limits
    no_op: bool

    @abstractmethod
    def params(self, scenes: Sequence[Scene]) -> Any:  # noqa: ANN401 - each has its own
        """Return scenes as parameters."""

    @abstractmethod
    def single_game(self, params: Any, game: int) -> Any:  # noqa: ANN401
        """Return the parameters of one game, for worlds of its topology alone (host)."""

    @abstractmethod
    def reset(self, params: Any, game: jax.Array) -> tuple[jax.Array, Any]:  # noqa: ANN401
        """Return what is seen, and the state, of an episode before its first step."""

    @abstractmethod
    def step(
        self,
        params: Any,  # noqa: ANN401
        state: Any,  # noqa: ANN401
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: jax.Array,
    ) -> StepResult:
        """Play on.

        Args:
            params: the games.
            state: of the episode.
            plan: (slots,) int32, the step before which each slot's block goes; -1 or a step gone by: it stays.
            stop_step: () int32, the step to play to, unless the episode ends before.
            executed: (slots,) bool, slots that a combined plan has executed then.
            next_game: () int32, the game of the episode that follows if this one has ended; -1 for none.
        """

    @abstractmethod
    def status(self, params: Any, state: Any) -> Status:  # noqa: ANN401
        """Return the status of an episode."""

    @abstractmethod
    def observe(self, params: Any, state: Any) -> jax.Array:  # noqa: ANN401
        """Return what is seen of an episode, but for pictures."""

    @abstractmethod
    def pose(self, params: Any, state: Any) -> tuple[Features, Pose]:  # noqa: ANN401
        """Return what a picture of an episode needs."""
