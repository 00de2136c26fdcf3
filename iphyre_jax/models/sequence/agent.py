"""Sequence models play: asked for a return, they give plans, in advance or on the way. Host; B worlds side by side.

On the way, a world is played again under the removals so far: that gives the bits of the environment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_SEED
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.models.outcome.plays.inputs import scene_rows
from iphyre_jax.models.sequence.decisions import centres, scaled, slot_objects
from iphyre_jax.models.sequence.networks import END, NEVER_BIN, NOWHERE, Logits, SequenceModel, Sequences
from iphyre_jax.models.sequence.settings import ASKED, SequenceConfig
from iphyre_jax.models.sequence.training import Params, log_likelihood
from iphyre_jax.models.sequence.worlds import play_tables
from iphyre_jax.plans import steps_to_times
from iphyre_jax.rules import (
    DECISIONS_PER_SECOND,
    ELIMINATION_REWARD,
    FRAMES,
    NEVER,
    SUCCESS_REWARD,
    TIME_LIMIT,
)
from iphyre_jax.scenes import MAX_ELIMINABLE, Scene, load_scene
from iphyre_jax.scenes.limits import OFFICIAL

COST: Final = -ELIMINATION_REWARD / SUCCESS_REWARD  # of a removal, as a return
TENTH: Final = 1 / DECISIONS_PER_SECOND / SUCCESS_REWARD  # of 0.1 s
BLOCK: Final = 64  # worlds that decide at once
STAYS: Final = 0.5  # chance from which on a block stays

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@partial(jax.jit, static_argnums=0)
def decide(
    config: SequenceConfig, params: Params, inputs: Sequences, k: jax.Array, sampled: jax.Array, key: jax.Array
) -> jax.Array:
    """The actions of decision k, (B, A) int32: the likeliest, or drawn by their likelihood.

    Args:
        config: settings.
        params: of one model.
        inputs: B sequences up to the state of decision k; what stands behind it does not count.
        k: () int32.
        sampled: () bool, whether to draw.
        key: random key; not read if nothing is drawn.
    """

    def pick(scores: jax.Array, number: int) -> jax.Array:
        noise = jax.random.gumbel(jax.random.fold_in(key, number), scores.shape)
        return (scores + jnp.where(sampled, noise, 0.0)).argmax(axis=-1)

    logits = cast(Logits, SequenceModel(config).apply(params, inputs))
    choice = pick(logits.choice[:, k], 0)
    if config.form == "plans":
        choice = jnp.where(sampled, choice, likeliest_times(logits.choice[:, k]))
    if config.form != "events":
        return jnp.asarray(choice if config.form == "plans" else choice[:, None], jnp.int32)
    known = inputs._replace(actions=inputs.actions.at[:, k, 0].set(choice))
    delay = cast(Logits, SequenceModel(config).apply(params, known)).delay[:, k]
    return jnp.stack([choice, pick(delay.at[:, 0].set(NOWHERE), 1)], axis=-1).astype(jnp.int32)


def likeliest_times(scores: jax.Array) -> jax.Array:
    """Times (B, 6) int32 from logits (B, 6, 151): a block goes if that is likelier than not, at its likeliest time.

    The likeliest of all 151 would be "never" too often: it is one number, and to go is spread over 150.
    """
    stays = jax.nn.softmax(scores)[..., NEVER_BIN] > STAYS
    return jnp.where(stays, NEVER_BIN, scores[..., :NEVER_BIN].argmax(axis=-1))


@dataclass
class Memory:
    """What B worlds have seen and done, with room for all decisions that a model sees at once."""

    returns: npt.NDArray[np.float32]
    rows: npt.NDArray[np.float32]
    centres: npt.NDArray[np.float32]
    actions: Ints
    time: Ints

    @classmethod
    def of(cls, config: SequenceConfig, scenes: Sequence[Scene], game: Ints, asked: float) -> Memory:
        """Before the first decision."""
        count, size, fixed = len(game), config.context, config.strategy == "in-advance"
        rows = np.repeat(scene_rows(scenes)[game][:, None], 1 if fixed else size, axis=1)
        parts = {"plans": MAX_ELIMINABLE, "choices": 1, "events": 2}[config.form]
        actions = np.zeros((count, size, parts), np.int32)
        if config.form == "events":
            actions[..., 0] = END
        returns = np.full((count, size), asked, np.float32)
        return cls(returns, rows, centres(scenes)[game], actions, np.zeros((count, size), np.int32))

    def inputs(self, index: npt.NDArray[np.integer[Any]]) -> Sequences:
        """Some worlds as the network takes them."""
        parts = (self.returns, self.rows, self.centres, self.actions, self.time)
        return Sequences(*jax.device_put([each[index] for each in parts]))

    def forget_first(self) -> None:
        """Make room for one more decision."""
        for each in (self.returns, self.rows, self.actions, self.time):
            each[:, :-1] = each[:, 1:]


class Player:
    """A model that plays B worlds.

    Args:
        config: settings.
        params: of one model.
        scenes: S scenes.
        game: (B,) index of each world's scene.
        asked: the return that is asked for.
        key: random key to draw actions; None: the likeliest ones.
    """

    def __init__(
        self,
        config: SequenceConfig,
        params: Params,
        scenes: Sequence[Scene],
        game: npt.NDArray[np.integer[Any]],
        asked: float = ASKED,
        key: jax.Array | None = None,
    ) -> None:
        self.config, self.params, self.scenes = config, params, tuple(scenes)
        self.game = np.asarray(game, np.int32)
        self.memory = Memory.of(config, self.scenes, self.game, asked)
        self._key, self._number = key, 0
        self._objects = slot_objects(self.scenes)[self.game]
        self.bins = np.full((len(self.game), MAX_ELIMINABLE), NEVER_BIN, np.int32)  # removals so far

    def plans(self) -> Floats:
        """(B, 6) s, NaN for a block that stays: what the model removed, or will."""
        if self.config.form == "events":
            self._play_events()
        elif self.config.strategy == "in-advance":
            self.bins = self._decide(0)
        elif self.config.strategy == "combined":
            self._play_combined()
        else:
            self._play_choices()
        self.bins = np.where(self._objects == END, NEVER_BIN, self.bins)
        return np.where(self.bins == NEVER_BIN, np.nan, self.bins / DECISIONS_PER_SECOND)

    def steps(self) -> npt.NDArray[np.int64]:
        """(B, 6) the steps before which blocks go, -1 for never, by the removals so far."""
        stays, protocol = self.bins == NEVER_BIN, self.config.protocol
        if self.config.form == "choices":
            return np.where(stays, NEVER, self.bins * (protocol.fps // DECISIONS_PER_SECOND))
        return protocol.steps(np.where(stays, np.nan, self.bins / DECISIONS_PER_SECOND))

    def _decide(self, k: int) -> Ints:
        key = jax.random.fold_in(self._key if self._key is not None else jax.random.key(0), self._number)
        self._number += 1
        sampled = jnp.asarray(self._key is not None)
        for number, (index, count) in enumerate(blocks(len(self.game))):
            inputs, own = self.memory.inputs(index), jax.random.fold_in(key, number)
            action = decide(self.config, self.params, inputs, jnp.int32(k), sampled, own)
            self.memory.actions[index[:count], k] = np.asarray(action)[:count]
        return self.memory.actions[:, k].copy()

    def _pay(self, k: int, removed: npt.NDArray[np.bool_], tenths: Ints) -> None:
        """The return of decision k, after what decision k - 1 has cost."""
        paid = COST * removed + TENTH * tenths
        before = self.memory.returns[:, k - 1]
        self.memory.returns[:, k] = before if self.config.coded_labels else before + paid

    def _observe(self, k: int, frames: Ints) -> None:
        """The tables at some tenths of a second under the removals so far."""
        if self.config.strategy != "in-advance":
            found = play_tables(self.scenes, self.game, self.steps(), self.config.protocol)
            at = np.clip(frames, 0, FRAMES - 1)
            self.memory.rows[:, k] = scaled(found[np.arange(len(at)), at])

    def _play_events(self) -> None:
        now = np.zeros(len(self.game), np.int32)
        active = np.ones(len(self.game), bool)
        for k in range(self.config.context):
            action = self._decide(k)
            then = now + action[:, 1]
            active &= (action[:, 0] != END) & (then < FRAMES)
            slot = (self._objects == action[:, :1]).argmax(axis=1)
            self.bins[active, slot[active]] = then[active]
            if k + 1 == self.config.context or not active.any():
                return
            then = np.where(active, then, now)
            self._pay(k + 1, active, then - now)
            self.memory.time[:, k + 1] = now = then
            self._observe(k + 1, now + 1)

    def _play_combined(self) -> None:
        now, last = np.ones(len(self.game), np.int32), np.zeros(len(self.game), np.int32)
        for k in range(self.config.context):
            action = self._decide(k)
            gone = (self.bins != NEVER_BIN) | (self._objects == END)
            due = np.where(gone | (action < now[:, None]), NEVER_BIN, action)
            slot, frame = due.argmin(axis=1), due.min(axis=1)
            acts = frame < NEVER_BIN
            self.bins[acts, slot[acts]] = frame[acts]
            if k + 1 == self.config.context or not acts.any():
                return
            then = np.where(acts, frame, last).astype(np.int32)
            self._pay(k + 1, acts, then - last)
            self.memory.time[:, k + 1] = last = then
            now = np.where(acts, frame + 1, FRAMES).astype(np.int32)
            self._observe(k + 1, last + 1)

    def _play_choices(self) -> None:
        table = play_tables(self.scenes, self.game, self.steps(), self.config.protocol)
        removed = np.zeros(len(self.game), bool)
        for frame in range(FRAMES):
            k = min(frame, self.config.context - 1)
            if frame >= self.config.context:
                self.memory.forget_first()
            if frame:
                self._pay(k, removed, np.ones(len(self.game), np.int32))
            self.memory.rows[:, k], self.memory.time[:, k] = scaled(table[:, frame].copy()), frame
            action = self._decide(k)[:, 0]
            rows = np.arange(len(action))
            slot = np.maximum(action - 1, 0)
            removed = (action > 0) & (self.bins[rows, slot] == NEVER_BIN) & (self._objects[rows, slot] != END)
            if removed.any():
                self.bins[removed, slot[removed]] = frame
                own = self.steps()[removed]
                table[removed] = play_tables(self.scenes, self.game[removed], own, self.config.protocol)


@dataclass(frozen=True, eq=False)
class SequenceTries:
    """An agent for `attempts`: a model's greedy plan comes first, then drawn ones.

    Attributes:
        config: settings; the attempts are made at their rate.
        params: of one model.
    """

    config: SequenceConfig
    params: Params

    @default_options()
    def __call__(self, scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Any]) -> Floats:
        """Propose k plans, (k, S) s, NaN for a block that stays; of the past only its length counts.

        The rule "simulate" takes the steps that the model's own rule takes. It removes nothing at the very start, so
        what a model removes there goes one step later.
        """
        greedy = 0 if past else 1
        key = jax.random.key(int(rng.integers(MAX_SEED)))
        steps = []
        for count, own in ((greedy, None), (k - greedy, key)):
            if count:
                player = Player(
                    self.config, self.params, [load_scene(scene, OFFICIAL)], np.zeros(count, np.int32), key=own
                )
                player.plans()
                steps.append(player.steps())
        made = np.concatenate(steps)[:, : len(scene.eliminable_blocks)]
        return steps_to_times(made, self.config.fps)


def contrast(player: Player) -> Floats:
    """How much likelier each world's plan is if a high return is asked for than if a failure is, (B,) logarithms.

    Args:
        player: in advance, with events, after `plans`.
    """
    memory, config = player.memory, player.config
    # A removal after 15 s ends a play as END does.
    stops = (memory.actions[..., 0] == END) | (memory.time + memory.actions[..., 1] >= FRAMES)
    made = np.cumsum(stops, axis=1) - stops == 0
    left = (made & ~stops)[:, ::-1].cumsum(axis=1)[:, ::-1]
    failure = -COST * left - (TIME_LIMIT / SUCCESS_REWARD - TENTH * memory.time)
    found = np.zeros(len(made))
    for index, count in blocks(len(made)):
        inputs = memory.inputs(index)
        failing = inputs._replace(returns=jnp.asarray(failure[index], jnp.float32))
        good, bad = (_likelihood(config, player.params, each, jnp.asarray(made[index])) for each in (inputs, failing))
        found[index[:count]] = np.asarray(good - bad)[:count]
    return found


def blocks(count: int) -> Iterator[tuple[npt.NDArray[np.int64], int]]:
    """Indices of worlds, BLOCK at a time, and how many of them count: the last block is filled up with the first one.

    One program serves any number of worlds.
    """
    for first in range(0, count, BLOCK):
        index = np.arange(first, first + BLOCK)
        yield np.where(index < count, index, 0), min(BLOCK, count - first)


@partial(jax.jit, static_argnums=0)
def _likelihood(config: SequenceConfig, params: Params, inputs: Sequences, made: jax.Array) -> jax.Array:
    logits = cast(Logits, SequenceModel(config).apply(params, inputs))
    each = log_likelihood(config, logits, inputs.actions, config.smoothing)
    weight = jnp.stack([made, made & (inputs.actions[..., 0] != END)], axis=-1)
    return jnp.where(weight, jnp.maximum(each, NOWHERE), 0.0).sum(axis=(1, 2))
