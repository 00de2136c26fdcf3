"""Environments: the paper's three strategies as pure functions over batched worlds."""

from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.evaluation import Scores, evaluate
from iphyre_jax.envs.params import EnvParams, EnvState, make_params
from iphyre_jax.envs.registry import environment_ids, make, register
from iphyre_jax.envs.spaces import Box, Discrete

__all__ = [
    "Box",
    "Discrete",
    "EnvParams",
    "EnvState",
    "Environment",
    "Scores",
    "environment_ids",
    "evaluate",
    "make",
    "make_params",
    "register",
]
