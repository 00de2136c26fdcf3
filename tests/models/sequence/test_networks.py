"""The transformer is causal: nothing that comes later changes what is given at a decision."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.models.sequence.networks import END, Logits, SequenceModel, Sequences
from iphyre_jax.models.sequence.settings import SequenceConfig, settings

TINY = {"layers": 1, "width": 16, "heads": 2, "context": 4}
CONFIGS = {
    config.form: dataclasses.replace(config, **TINY)
    for config in (settings("paper", "combined"), settings("paper", "on-the-fly"), settings("ours", "combined"))
}


def made_up(config: SequenceConfig, seed: int) -> Sequences:
    """Two sequences of random numbers: three blocks that can go, and a ball."""
    rng = np.random.default_rng(seed)
    shape = 2, config.context
    rows = np.zeros((*shape, 12, 9), np.float32)
    rows[:, :, :4, :4] = rng.random((*shape, 4, 4))
    rows[:, :, 3, 2:4] = rows[:, :, 3, 0:2]
    rows[:, :, :4, 4] = 10 / 600
    rows[:, :, :3, 5] = 1
    centres = np.zeros((2, 6, 2), np.float32)
    centres[:, :3] = rng.random((2, 3, 2))
    actions = {
        "plans": rng.integers(0, 151, (*shape, 6)),
        "choices": rng.integers(0, 4, (*shape, 1)),
        "events": np.stack([np.broadcast_to([0, 1, 2, END], shape), rng.integers(1, 20, shape)], axis=-1),
    }[config.form]
    time = np.sort(rng.integers(0, 100, shape), axis=1)
    parts = (rng.random(shape), rows, centres, actions, time)
    return Sequences(*(jnp.asarray(part, np.int32 if part.dtype.kind == "i" else np.float32) for part in parts))


@partial(jax.jit, static_argnums=0)
def forward(config: SequenceConfig, inputs: Sequences) -> Logits:
    model = SequenceModel(config)
    params = model.init(jax.random.key(0), inputs)
    noisy = jax.tree.map(lambda leaf: leaf + 0.1 * jnp.sin(jnp.arange(leaf.size).reshape(leaf.shape)), params)
    return model.apply(noisy, inputs)


@pytest.mark.slow
@pytest.mark.parametrize("form", CONFIGS)
def test_the_future_changes_nothing(form: str) -> None:
    config = CONFIGS[form]
    inputs, other = made_up(config, 0), made_up(config, 1)
    given = forward(config, inputs)
    for t in range(config.context):
        # All inputs after decision t, and what was done at it: the choice at t must not know either.
        def later(one: jax.Array, two: jax.Array, first: int) -> jax.Array:
            return jnp.concatenate([one[:, :first], two[:, first:]], axis=1)

        perturbed = Sequences(
            later(inputs.returns, other.returns, t + 1),
            later(inputs.rows, other.rows, t + 1),
            inputs.centres,
            later(inputs.actions, inputs.actions[:, ::-1] if form == "events" else other.actions, t),
            later(inputs.time, other.time, t + 1),
        )
        found = forward(config, perturbed)
        np.testing.assert_array_equal(found.choice[:, : t + 1], given.choice[:, : t + 1])
        np.testing.assert_array_equal(found.delay[:, :t], given.delay[:, :t])
        if t + 1 < config.context:
            assert not np.allclose(found.choice[:, t + 1 :], given.choice[:, t + 1 :])


def test_the_present_counts() -> None:
    config = CONFIGS["events"]
    inputs = made_up(config, 0)
    given = forward(config, inputs)
    for field in ("returns", "rows", "time"):
        other = getattr(made_up(config, 1), field)[:, 0]
        changed = inputs._replace(**{field: getattr(inputs, field).at[:, 0].set(other)})
        assert not np.allclose(forward(config, changed).choice[:, 0], given.choice[:, 0])


def test_a_block_goes_once_and_only_blocks_go() -> None:
    config = CONFIGS["events"]
    choice = np.asarray(forward(config, made_up(config, 0)).choice)
    possible = choice > -1e8
    np.testing.assert_array_equal(possible[0, :, :3], [[1, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 0]])
    assert possible[..., END].all()
    assert not possible[..., 3:END].any()


def test_a_clone_does_not_see_the_return() -> None:
    config = dataclasses.replace(CONFIGS["plans"], returns=False)
    inputs = made_up(config, 0)
    np.testing.assert_array_equal(
        forward(config, inputs).choice, forward(config, inputs._replace(returns=inputs.returns + 1)).choice
    )
