"""The policy network."""

from __future__ import annotations

from collections.abc import Sequence

import flax.linen as nn
import jax

from iphyre_jax.scenes import MAX_ELIMINABLE

OUTPUT_SCALE = 0.01  # small last layer: the first policy is the action head's prior, for every scene


class PlanNetwork(nn.Module):
    """Multilayer perceptron from an observation to the outputs that an action head asks for.

    Attributes:
        hidden: widths of the hidden layers.
        outputs: numbers that the action head wants for each slot.
    """

    hidden: Sequence[int]
    outputs: int

    @nn.compact
    def __call__(self, observation: jax.Array) -> jax.Array:
        """(B, 120) float32 observations -> (B, 6, outputs) float32."""
        x = observation
        for width in self.hidden:
            x = nn.tanh(nn.Dense(width, kernel_init=nn.initializers.orthogonal(2.0**0.5))(x))
        x = nn.Dense(MAX_ELIMINABLE * self.outputs, kernel_init=nn.initializers.orthogonal(OUTPUT_SCALE))(x)
        return x.reshape(x.shape[0], MAX_ELIMINABLE, self.outputs)
