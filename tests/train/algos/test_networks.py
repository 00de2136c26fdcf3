"""Networks: shapes, the start at the head's prior, and objects that do not care for their row."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.envs.in_advance import observation_table
from iphyre_jax.scenes import load_scene
from iphyre_jax.train.algos import actor_critic
from iphyre_jax.train.algos.networks import ObjectNetwork, Perceptron
from iphyre_jax.train.observations import parts, slot_mask, start_observations
from iphyre_jax.train.settings.presets import preset
from iphyre_jax.train.settings.run import TrainConfig

SEEN = jnp.asarray(observation_table(("hole", "multi_ball_spring")))


@pytest.mark.parametrize("shape", [(6, 3), (7,), ()])
def test_outputs_have_the_shape_asked_for(shape: tuple[int, ...]) -> None:
    for network in (Perceptron((16,), "relu", shape, 1.0), ObjectNetwork((16, 8), shape, 1.0)):
        params = jax.eval_shape(network.init, jax.random.key(0), SEEN)
        assert jax.eval_shape(network.apply, params, SEEN).shape == (2, *shape)


def test_a_dueling_network_parts_value_from_deviations() -> None:
    network = Perceptron((16,), "relu", (7,), 1.0, dueling=True)
    params = jax.jit(network.init)(jax.random.key(0), SEEN)
    outputs = network.apply(params, SEEN)
    layers = jax.tree.map(np.asarray, params["params"])
    hidden = np.maximum(np.asarray(SEEN) @ layers["Dense_0"]["kernel"] + layers["Dense_0"]["bias"], 0)
    np.testing.assert_allclose(outputs.mean(axis=-1), (hidden @ layers["Dense_2"]["kernel"])[:, 0], atol=1e-5)


def test_a_centred_network_takes_away_what_it_was_initialised_with() -> None:
    given = {"hidden": (16,), "activation": "relu", "shape": (3,), "scale": 1.0}
    plain, centred = Perceptron(**given), Perceptron(**given, centred=True)  # type: ignore[arg-type]
    params = centred.init(jax.random.key(0), SEEN)
    layers = {"params": {name: value for name, value in params["params"].items() if name != "centre"}}
    other = SEEN[:1] + 0.1
    expected = plain.apply(layers, 2.0 * (other - SEEN.mean(axis=0, keepdims=True)))
    np.testing.assert_allclose(centred.apply(params, other), expected, atol=1e-5)
    change = jax.grad(lambda given: centred.apply(given, other).sum())(params)  # type: ignore[attr-defined]
    assert not np.asarray(change["params"]["centre"]).any()  # it stays what it is


def shuffled(seen: jax.Array) -> jax.Array:
    """The same objects in other rows; the candidates, and so the slots, as they were."""
    taken = parts(seen)
    rows = taken.rows[:, np.random.default_rng(1).permutation(12)]
    return jnp.concatenate([rows.reshape(len(seen), -1), taken.candidates.reshape(len(seen), -1)], axis=1)


def test_objects_do_not_care_for_their_row() -> None:
    network = ObjectNetwork((16, 16), (6, 5), 1.0)
    params, apply = jax.jit(network.init)(jax.random.key(0), SEEN), jax.jit(network.apply)
    there = np.asarray(slot_mask(SEEN))
    one, other = apply(params, SEEN), apply(params, shuffled(SEEN))
    np.testing.assert_allclose(one, other, atol=1e-4)
    assert np.abs(np.asarray(one)[there]).max() > 0.01
    assert len(np.unique(np.asarray(one)[0][there[0]].round(4), axis=0)) == there[0].sum()  # each slot its own


def test_the_first_policy_is_the_prior_for_every_scene() -> None:
    config = TrainConfig(hidden=(32,))
    for network in ("perceptron", "objects"):
        chosen = dataclasses.replace(config, network=network)  # type: ignore[arg-type]
        params = jax.jit(actor_critic.init_params, static_argnums=0)(chosen, jax.random.key(0), SEEN[:1])
        outputs = jax.jit(actor_critic.outputs, static_argnums=0)(chosen, params, SEEN)
        assert float(jnp.abs(outputs).max()) < 0.1


def test_masks_are_found_in_every_kind_of_observation() -> None:
    for strategy in ("in-advance", "combined", "on-the-fly"):
        for observation in ("official", "motion"):
            seen = start_observations(strategy, observation, ["hole", "support"])  # type: ignore[arg-type]
            blocks = [len(load_scene(game).eliminable_blocks) for game in ("hole", "support")]
            np.testing.assert_array_equal(slot_mask(seen).sum(axis=1), blocks)
    assert preset("ppo", "on-the-fly").observation == "motion"
