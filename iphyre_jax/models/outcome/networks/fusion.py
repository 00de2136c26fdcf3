"""Networks of outcome classifiers: the paper's three, two that see only one of their inputs, and ours.

All take B plans with their scenes and give logits (B, 2), of failure and success.
"""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp

from iphyre_jax.models.outcome.networks.ranker import RankerNetwork
from iphyre_jax.models.outcome.networks.relations import RelationNetwork
from iphyre_jax.models.outcome.plays.inputs import Plans, Scenes
from iphyre_jax.models.outcome.settings import OutcomeConfig

FUSED = 256  # width of the encoders of whole scenes and plans
OBJECT = 64  # of single objects
SCENE_SHARE, PICTURE_SHARE = 0.8, 0.2  # of table and picture in the paper's Vision Fusion
CHANNELS = (16, 32, 64, 64)  # of the picture's convolutions, each of which halves its sides
CLASSES = 2


class TorchDense(nn.Module):
    """A linear layer with PyTorch's initial values: weights and biases uniform within 1 / sqrt(inputs).

    Attributes:
        width: number of outputs.
    """

    width: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """(..., D) -> (..., width)."""
        bound = x.shape[-1] ** -0.5

        def uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
            return jax.random.uniform(key, shape, jnp.float32, -bound, bound)

        kernel = self.param("kernel", uniform, (x.shape[-1], self.width))
        bias = self.param("bias", uniform, (self.width,))
        return x @ kernel + bias.reshape(*(1,) * (x.ndim - 1), -1)


def _flat(plans: Plans, flag: bool) -> jax.Array:
    """Numbers of whole plans: (B, 12) seconds, with a flag for each object behind them if asked for."""
    return jnp.concatenate([plans.seconds, plans.removed] if flag else [plans.seconds], axis=-1)


class Fusion(nn.Module):
    """Global and Vision Fusion, and their halves: encode scene, plan and picture as wholes and add them up.

    Attributes:
        inputs: which of "scene", "plan" and "picture" are seen.
        removal_flag: whether plans say which objects they remove.
    """

    inputs: tuple[str, ...]
    removal_flag: bool

    @nn.compact
    def __call__(self, rows: jax.Array, plans: Plans, scenes: Scenes, game: jax.Array) -> jax.Array:
        """See the module; rows: (B, 12, 9), scenes: all S of them, game: (B,) which one each row is."""
        fused = jnp.zeros((len(rows), FUSED))
        share = SCENE_SHARE if "picture" in self.inputs else 1.0
        if "scene" in self.inputs:
            fused += share * nn.relu(TorchDense(FUSED)(rows.reshape(len(rows), -1)))
        if "plan" in self.inputs:
            fused += nn.relu(TorchDense(FUSED)(_flat(plans, self.removal_flag)))
        if "picture" in self.inputs:
            # Each scene is encoded once. A product picks a row's scene, for the gradient of a gather is a scatter.
            picked = jax.nn.one_hot(game, len(scenes.pictures))
            fused += PICTURE_SHARE * (picked @ PictureEncoder()(jnp.asarray(scenes.pictures)))
        return TorchDense(CLASSES)(fused)


class PictureEncoder(nn.Module):
    """Convolutions, trained from scratch: the paper's vision transformer needs weights that cannot be had offline."""

    @nn.compact
    def __call__(self, pictures: jax.Array) -> jax.Array:
        """(S, P, P, 3) from 0 to 1 -> (S, 256)."""
        x = 1.0 - pictures  # white is nothing
        for channels in CHANNELS:
            x = nn.relu(nn.Conv(channels, (3, 3), (2, 2))(x))
        return TorchDense(FUSED)(x.reshape(len(x), -1))


class ObjectFusion(nn.Module):
    """Object Fusion: encode each object and its removal, add the two, read all of them at once.

    Attributes:
        removal_flag: whether plans say which objects they remove.
    """

    removal_flag: bool

    @nn.compact
    def __call__(self, rows: jax.Array, plans: Plans, scenes: Scenes, game: jax.Array) -> jax.Array:
        """See `Fusion`."""
        each = [plans.seconds, plans.removed] if self.removal_flag else [plans.seconds]
        objects = nn.relu(TorchDense(OBJECT)(rows)) + nn.relu(TorchDense(OBJECT)(jnp.stack(each, axis=-1)))
        return TorchDense(CLASSES)(objects.reshape(len(rows), -1))


INPUTS = {"global": ("scene", "plan"), "vision": ("scene", "plan", "picture"), "plan": ("plan",), "scene": ("scene",)}


def network(config: OutcomeConfig) -> nn.Module:
    """The network of these settings."""
    if config.network == "relations":
        return RelationNetwork(config.width, config.rounds)
    if config.network == "ranker":
        return RankerNetwork(config.width, config.rounds)
    if config.network == "object":
        return ObjectFusion(config.removal_flag)
    return Fusion(INPUTS[config.network], config.removal_flag)
