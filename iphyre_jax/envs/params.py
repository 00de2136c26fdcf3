"""The data of an environment: its games, and the state of an episode. Users see only the named properties."""

from __future__ import annotations

import hashlib
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, NamedTuple, TypeVar

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.next_game import NextGame
from iphyre_jax.envs.batching.status import Status
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.observations.features import Features, Pose, present_objects, scene_tables
from iphyre_jax.observations.vectors import ObservationName
from iphyre_jax.physics.shared_topologies import can_play, with_absent
from iphyre_jax.physics.types import State, Topology, World
from iphyre_jax.rollouts import FAULT_NOT_FINITE
from iphyre_jax.scenes import Limits, Scene

Tree = TypeVar("Tree")


class EnvParams(ABC):
    """The games of an environment, one a row of every array; each episode plays one of them."""

    made_for: str
    """See `Worlds.made_for`; no array, but a part of the tree's structure."""

    @property
    def n_games(self) -> int:
        """The number of games; their names are `Environment.games`."""
        return self.topology_id.shape[-1]

    @property
    def games(self) -> int:
        """The old name of `n_games`."""
        warnings.warn("EnvParams.games: use EnvParams.n_games", DeprecationWarning, stacklevel=2)
        return self.n_games

    @property
    @abstractmethod
    def topology_id(self) -> jax.Array:
        """Topology of each game, (games,) int32, an index into `Environment.topologies`."""


class EnvState(ABC):
    """An episode of one game: a tree of arrays, each with an axis in front for a batch of episodes."""

    @property
    @abstractmethod
    def game(self) -> jax.Array:
        """Row of the parameters, () int32."""


class StepResult(NamedTuple):
    """What one decision returns."""

    state: Any  # of the next episode if this one has ended
    obs: jax.Array  # of `state`
    before: Status  # before the decision; read from the old state afterwards, it would cost a copy of that
    status: Status  # after the decision, before any reset
    final_state: Any  # after the decision, before any reset; None if not asked for
    final_obs: jax.Array | None  # of `final_state`


@dataclass(frozen=True)
class Worlds(ABC):
    """Resets, plays and observes episodes of one world; `jax.vmap` makes batches. `host.worlds`, `traced.worlds`.

    Hashable. Attributes are those of `Environment`. no_op: whether observations have a candidate that does nothing;
    keep_final: whether `step` also returns an ended episode before its reset.
    """

    state_type: ClassVar[type[EnvState]]  # made by its arrays and `state_of`

    topologies: tuple[Topology, ...]
    dtype: str
    protocol: EpisodeProtocol
    observation: ObservationName
    limits: Limits
    no_op: bool
    keep_final: bool

    @cached_property
    def made_for(self) -> str:
        """What parameters must be made for: all attributes that decide what is in them, as a digest."""
        return self._digest()

    @cached_property
    def state_of(self) -> str:
        """What states are of: all attributes that decide what is in them, as a digest. Strategies share states."""
        return self._digest(self.protocol)

    def _digest(self, *more: object) -> str:
        shared = type(self).__name__, self.topologies, self.dtype, self.limits, self.protocol.resets
        return _digest_of(*shared, *more)

    def world_of(self, scene: Scene) -> tuple[int, World]:
        """Return which of the topologies plays a scene, that with the fewest constraints, and its world for it (host).

        Raises:
            ValueError: none can; one line.
        """
        own, world = cached_world(scene, self.protocol.resets, self.dtype)
        able = [k for k, shared in enumerate(self.topologies) if can_play(shared, own)]
        if not able:
            raise ValueError(
                f"scenes: expected topologies of this environment, but {scene.name} has another; "
                "make the environment with this scene among its own"
            )
        topology_id = min(able, key=lambda k: len(self.topologies[k].constraint_ends))
        return topology_id, with_absent(self.topologies[topology_id], own, world)

    def params(self, scenes: Sequence[Scene]) -> Any:  # noqa: ANN401 - each has its own
        """Return scenes as parameters.

        Raises:
            ValueError: see `world_of`.
        """
        built = [self.world_of(scene) for scene in scenes]
        features = [scene_tables(scene, self.topologies, self.dtype) for scene in scenes]
        return self.params_of([(one, world, own) for (one, world), own in zip(built, features, strict=True)])

    @abstractmethod
    def params_of(self, games: Sequence[tuple[int, World, Features]]) -> Any:  # noqa: ANN401
        """Return games as parameters, each with the number of its topology."""

    @abstractmethod
    def single_game(self, params: Any, game: int) -> tuple[Topology, Any]:  # noqa: ANN401
        """Return the topology of one game, without constraints that it lacks, and its parameters for that (host)."""

    @abstractmethod
    def reset(self, params: Any, game: jax.Array) -> tuple[jax.Array, Any]:  # noqa: ANN401
        """Return the observation and the state of an episode before its first step."""

    @abstractmethod
    def step(
        self,
        params: Any,  # noqa: ANN401
        state: Any,  # noqa: ANN401
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: NextGame,
    ) -> StepResult:
        """Play one decision.

        Args:
            params: the games.
            state: of the episode.
            plan: (slots,) int32, the step before which each slot's block goes; it stays at -1 or a past step.
            stop_step: () int32, the step to play to, unless the episode ends earlier.
            executed: (slots,) bool, slots that a combined plan has executed by then.
            next_game: of the next episode if this one ends.
        """

    @abstractmethod
    def status(self, params: Any, state: Any) -> Status:  # noqa: ANN401
        """Return the status of an episode."""

    @abstractmethod
    def observe(self, params: Any, state: Any) -> jax.Array:  # noqa: ANN401
        """Return the observation of an episode, except images."""

    @abstractmethod
    def bodies(self, params: Any, state: Any) -> jax.Array:  # noqa: ANN401
        """Return x, y, angle, velocity x and y, and angular velocity of the moving bodies, (6, bodies)."""

    @abstractmethod
    def first_rows(self, topology: Topology) -> State:
        """Return the first row that each array of numbers of a state has in an episode of a topology."""

    def body_rows(self, bodies: int) -> npt.NDArray[np.int32]:
        """Return the rows of an episode that hold the numbers of `bodies`, (topologies, 6, bodies).

        A body that a smaller topology lacks has the row of the first one; nobody sees it.
        """
        tables = []
        for topology in self.topologies:
            state = self.first_rows(topology)
            velocity = state.motion.velocity
            starts = [state.position.x, state.position.y, state.angle, velocity.x, velocity.y]
            own = np.arange(bodies) * (np.arange(bodies) < topology.moving)
            tables.append(np.array([*starts, state.motion.angular_velocity])[:, None] + own)
        return np.array(tables, np.int32)

    def pose(self, params: Any, state: Any) -> tuple[Features, Pose]:  # noqa: ANN401
        """Return what a picture of an episode needs."""
        features: Features = jax.tree.map(lambda leaf: leaf[state.game], params.features)
        status = self.status(params, state)
        x, y, angle, *_ = self.bodies(params, state)
        sound = status.fault != FAULT_NOT_FINITE
        return features, Pose(x, y, angle, present_objects(features, status.present), sound)


@lru_cache(256)
def _digest_of(*values: object) -> str:
    """Return the SHA-256 sum of some values' representations."""
    return hashlib.sha256(repr(values).encode()).hexdigest()


def stacked(rows: Sequence[Tree]) -> Tree:
    """Return trees of arrays as one on the device, a row each."""
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *rows))


def on_host(content: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return attributes, some of them as NumPy arrays: loaded without x64, JAX's 64-bit arrays would lose half."""
    return content | {name: jax.tree.map(np.asarray, content[name]) for name in names}


def on_device(content: dict[str, Any], names: Sequence[str], x64: bool) -> dict[str, Any]:
    """Return attributes from `on_host` as they were."""
    with jax.enable_x64(x64):
        return content | {name: jax.device_put(content[name]) for name in names}
