"""A perceptron with two hidden layers and a straight connection, as a tree of arrays."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

Params = dict[str, Any]


def _dense(key: jax.Array, inputs: int, outputs: int, scale: float = 1.4) -> dict[str, jax.Array]:
    weight = jax.random.normal(key, (inputs, outputs)) * (scale / inputs**0.5)
    return {"weight": weight, "bias": jnp.zeros(outputs)}


def mlp(key: jax.Array, inputs: int, width: int, outputs: int) -> Params:
    """Parameters before training; the answers are small at first."""
    keys = jax.random.split(key, 4)
    return {
        "first": _dense(keys[0], inputs, width),
        "second": _dense(keys[1], width, width),
        "last": _dense(keys[2], width, outputs, 0.1),
        "straight": _dense(keys[3], inputs, outputs, 0.01),
    }


def _linear(params: Params, x: jax.Array) -> jax.Array:
    return x @ params["weight"] + params["bias"].reshape((1,) * (x.ndim - 1) + (-1,))


def apply(params: Params, x: jax.Array) -> jax.Array:
    """Answers (..., outputs) to features (..., inputs)."""
    hidden = jax.nn.relu(_linear(params["first"], x))
    hidden = jax.nn.relu(_linear(params["second"], hidden))
    return _linear(params["last"], hidden) + _linear(params["straight"], x)
