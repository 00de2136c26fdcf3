"""`mdrnn`: the paper's recurrent mixture density network over the official table, with four repairs.

Lengths alone are divided by 600; standard deviations have a floor; only end points of moving bodies are in the
likelihood, and whether an object is there is a chance of its own; rewards are those of the game.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.models.world.networks.mixture import GaussianMixture, bounded_sigma, expected, log_likelihood
from iphyre_jax.models.world.rows import rows_of
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import Plays, SceneTables, state_of
from iphyre_jax.observations.official import COLUMNS, LENGTH_COLUMNS
from iphyre_jax.rules import DECISIONS_PER_SECOND, ELIMINATION_REWARD, SCREEN, SECOND_REWARD, SUCCESS_REWARD
from iphyre_jax.scenes import MAX_OBJECTS

GAUSSIANS: Final = 5
HIDDEN: Final = 256
NUMBERS: Final = MAX_OBJECTS * COLUMNS
ENDS: Final = 4  # columns of a row that say where its ends are
REWARD_UNIT: Final = 1000.0  # points, of an output of size one

Params = dict[str, Any]
Memory = tuple[jax.Array, jax.Array]  # (B, 256) twice


class Output(NamedTuple):
    """What the network says of the next 0.1 s."""

    table: GaussianMixture  # of 108 numbers
    there: jax.Array  # (B, 12) logits: the object is there
    reward: jax.Array  # (B,) / 1,000 points
    end: jax.Array  # (B,) logit: the play is over


def init(config: WorldConfig, key: jax.Array) -> Params:
    """Parameters before training."""
    del config
    keys = jax.random.split(key, 3)
    inputs, outputs = NUMBERS + 2, 2 * GAUSSIANS * NUMBERS + GAUSSIANS + MAX_OBJECTS + 2

    def uniform(one: jax.Array, rows: int, columns: int) -> jax.Array:
        return jax.random.uniform(one, (rows, columns), minval=-1.0, maxval=1.0) / HIDDEN**0.5

    return {
        "input": uniform(keys[0], inputs, 4 * HIDDEN),
        "hidden": uniform(keys[1], HIDDEN, 4 * HIDDEN),
        "bias": jnp.zeros(4 * HIDDEN).at[HIDDEN : 2 * HIDDEN].set(1.0),
        "output": uniform(keys[2], HIDDEN, outputs),
        "output_bias": jnp.zeros(outputs),
    }


def scaled(rows: jax.Array) -> jax.Array:
    """Tables (..., 12, 9 or more) in px -> (..., 108), lengths / 600."""
    lengths, flags = rows[..., :LENGTH_COLUMNS] / SCREEN, rows[..., LENGTH_COLUMNS:COLUMNS]
    return jnp.concatenate([lengths, flags], axis=-1).reshape(*rows.shape[:-2], NUMBERS)


def empty_memory(count: int) -> Memory:
    """What the network remembers before it has seen anything."""
    return jnp.zeros((count, HIDDEN)), jnp.zeros((count, HIDDEN))


def forward(params: Params, memory: Memory, table: jax.Array, action: jax.Array) -> tuple[Output, Memory]:
    """One step. The mixture's means are changes of the table, so that what stays is easy to say.

    Args:
        params: as `init` gives them.
        memory: of B worlds.
        table: (B, 108), as `scaled` gives it.
        action: (B, 2) centre of the removed block / 600, zeros for none.
    """
    hidden, cell = memory
    gates = (
        jnp.concatenate([table, action], axis=-1) @ params["input"] + hidden @ params["hidden"] + params["bias"][None]
    )
    enter, forget, new, leave = jnp.split(gates, 4, axis=-1)
    cell = jax.nn.sigmoid(forget) * cell + jax.nn.sigmoid(enter) * jnp.tanh(new)
    hidden = jax.nn.sigmoid(leave) * jnp.tanh(cell)
    out = hidden @ params["output"] + params["output_bias"][None]
    size = GAUSSIANS * NUMBERS
    shape = (*out.shape[:-1], GAUSSIANS, NUMBERS)
    mean = table[..., None, :] + out[..., :size].reshape(shape)
    mixture = GaussianMixture(
        out[..., 2 * size : 2 * size + GAUSSIANS], mean, bounded_sigma(out[..., size : 2 * size].reshape(shape))
    )
    rest = out[..., 2 * size + GAUSSIANS :]
    there = rest[..., :MAX_OBJECTS] + 4 * (2 * (table[..., LENGTH_COLUMNS - 1 :: COLUMNS] > 0) - 1.0)
    return Output(mixture, there, rest[..., MAX_OBJECTS], rest[..., MAX_OBJECTS + 1]), (hidden, cell)


def counted_numbers(scene: SceneTables) -> jax.Array:
    """Which of the 108 numbers can change: the ends of moving bodies, (B, 108) bool."""
    moving = (jax.nn.one_hot(scene.mover, MAX_OBJECTS) * scene.moves[..., None]).sum(axis=1) > 0
    return (moving[..., None] & (jnp.arange(COLUMNS) < ENDS)[None, None]).reshape(-1, NUMBERS)


def action_of(rows: jax.Array, removal: jax.Array) -> jax.Array:
    """Actions (B, 2): the centre of the first block that is removed, (B, 12) bool, / 600; zeros if none is."""
    centre = (rows[..., 0:2] + rows[..., 2:4]) / (2 * SCREEN)
    first = jax.nn.one_hot(removal.argmax(axis=-1), MAX_OBJECTS) * removal.any(axis=-1, keepdims=True)
    return (centre * first[..., None]).sum(axis=1)


def loss(params: Params, plays: Plays, number: jax.Array, instant: jax.Array, steps: int) -> jax.Array:
    """Mean loss of windows of `steps` steps from instants (B,) of plays (B,), weighed as in the paper's code."""
    scene = jax.tree.map(lambda table: jnp.asarray(table)[jnp.asarray(plays.scene)[number]], plays.scenes)
    gone, recorded = jnp.asarray(plays.gone)[number], jnp.asarray(plays.state)
    last, success = jnp.asarray(plays.valid)[number] - 1, jnp.asarray(plays.success)[number]
    counted = counted_numbers(scene)

    def table_at(k: jax.Array) -> jax.Array:
        return rows_of(scene, state_of(recorded[number, k]), gone >= k[:, None])  # before the removals that are due

    def advance(memory: Memory, k: jax.Array) -> tuple[Memory, jax.Array]:
        at = instant + k
        before, after = table_at(at), table_at(at + 1)
        removed = gone == at[:, None]
        output, memory = forward(params, memory, scaled(before), action_of(before, removed))
        there = (after[..., LENGTH_COLUMNS - 1] > 0).astype(jnp.float32)
        real = jnp.asarray(scene.radius) > 0
        shown = -log_likelihood(output.table, scaled(after), counted)
        chance = jnp.where(real, _cross_entropy(output.there, there), 0.0).sum(axis=-1)
        over = (at + 1 == last).astype(jnp.float32)
        solved = over * success * SUCCESS_REWARD
        reward = (
            solved + ELIMINATION_REWARD * removed.sum(axis=-1) + SECOND_REWARD / DECISIONS_PER_SECOND
        ) / REWARD_UNIT
        total = shown + chance + _cross_entropy(output.end, over) + jnp.square(output.reward - reward)
        return memory, total / (NUMBERS + 2)

    _, losses = jax.lax.scan(advance, empty_memory(len(number)), jnp.arange(steps))
    return losses.mean()


def _cross_entropy(logits: jax.Array, label: jax.Array) -> jax.Array:
    return jnp.maximum(logits, 0) - logits * label + jnp.log1p(jnp.exp(-jnp.abs(logits)))


def next_rows(
    params: Params, memory: Memory, rows: jax.Array, removal: jax.Array, scene: SceneTables
) -> tuple[jax.Array, Memory]:
    """The expected next tables (B, 12, 12) in px; what cannot change stays, and what is removed is gone.

    The official columns have no motion: its columns become differences over 0.1 s, and the spin is unknown, 0.
    """
    output, memory = forward(params, memory, scaled(rows), action_of(rows, removal))
    mean = expected(output.table).reshape(-1, MAX_OBJECTS, COLUMNS)[..., :ENDS] * SCREEN
    moving = counted_numbers(scene).reshape(-1, MAX_OBJECTS, COLUMNS)[..., :ENDS]
    ends = jnp.where(moving, mean, rows[..., :ENDS])
    shift = ((ends - rows[..., :ENDS])[..., 0:2] + (ends - rows[..., :ENDS])[..., 2:4]) / 2 * DECISIONS_PER_SECOND
    spin = jnp.zeros_like(shift[..., :1])
    found = jnp.concatenate([ends, rows[..., ENDS:COLUMNS], shift, spin], axis=-1)
    present = (rows[..., LENGTH_COLUMNS - 1] > 0) & ~removal
    return jnp.where(present[..., None], found, 0.0), memory
