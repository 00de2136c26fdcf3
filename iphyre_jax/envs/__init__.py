"""Environments: the paper's three strategies as pure functions over batched worlds."""

from iphyre_jax.envs.batching.unrolling import Batch, Steps, unroll, unroll_on_threads
from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.evaluation import Scores, evaluate
from iphyre_jax.envs.params import EnvParams, EnvState
from iphyre_jax.envs.registry import environment_ids, make, register
from iphyre_jax.envs.spaces import Box, Discrete

__all__ = [
    "Batch",
    "Box",
    "Discrete",
    "EnvParams",
    "EnvState",
    "Environment",
    "Scores",
    "Steps",
    "environment_ids",
    "evaluate",
    "make",
    "register",
    "unroll",
    "unroll_on_threads",
]
