"""One policy of several: trained alike but for the seed, it takes the product of their distributions.

Policies of other seeds err in other scenes. The mean of their log-probabilities, normalised, keeps what they agree on:
a product of experts (Hinton 2002). The mean of their probabilities instead would keep each one's own solution, and its
most probable times need not belong to one plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import jax.numpy as jnp

from iphyre_jax.provenance import differences
from iphyre_jax.train.algos.actor_critic import State
from iphyre_jax.train.algos.networks import NOTHING
from iphyre_jax.train.settings.agents import HeadName
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.named_files import without_paths

ALGORITHMS: Final = ("ppo", "a2c")
HEADS: Final[tuple[HeadName, ...]] = (
    "time_grid",
    "categorical",
    "uniform",
)  # products of other heads are no such heads


def ensemble(configs: Sequence[TrainConfig], states: Sequence[State]) -> State:
    """The state of an ensemble, for inference only; it plays wherever the state of one policy does.

    Args:
        configs: of the policies; only the seeds may differ.
        states: of their algorithms, as many.

    Raises:
        ValueError: one line; the policies cannot be one.
    """
    if not configs or len(configs) != len(states):
        raise ValueError(f"states: expected one for each of {len(configs)} policies, at least one, got {len(states)}")
    first = configs[0]
    if first.agent not in ALGORITHMS or first.head not in HEADS:
        expected = f"{' or '.join(ALGORITHMS)} with one of the heads {', '.join(HEADS)}"
        raise ValueError(f"ensemble: expected {expected}, got {first.agent} with {first.head}")
    wanted, *others = (without_paths(replace(config, seed=first.seed)) for config in configs)
    for other in others:
        if other != wanted:
            found = differences(other.to_json(), wanted.to_json())
            raise ValueError(f"ensemble: expected policies that differ in their seeds only, got {found}")
    members = tuple(state.params["policy"] for state in states)
    return State({"members": members}, NOTHING, jnp.zeros((), jnp.int32))
