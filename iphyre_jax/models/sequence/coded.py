"""Labels as the official code computes them, with their faults, to show what they teach. Nothing else may use them.

In advance, the return is 0 for a play that solves and 1000 for one that fails. On the fly it is 1 at every decision of
every play. Combined, it is 1 as well, and times are halved, also those at which states are taken, so that states
precede their actions; a block that stays is one that goes at 0.1 s.
"""

from __future__ import annotations

import numpy as np

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays.inputs import scene_rows
from iphyre_jax.models.sequence.decisions import Parts, choices, executed_bins, tables_at
from iphyre_jax.models.sequence.networks import NEVER_BIN
from iphyre_jax.models.sequence.settings import EVENTS
from iphyre_jax.scenes import MAX_ELIMINABLE


def plan_parts(plays: Dataset) -> Parts:
    """In advance: the return is reversed."""
    zero = np.zeros((len(plays), 1), np.int32)
    weight = np.ones((len(plays), 1, MAX_ELIMINABLE), np.float32)
    returns = (~plays.success[:, None]).astype(np.float32)
    return scene_rows(plays.scenes), plays.game[:, None], returns, executed_bins(plays)[:, None], zero, weight


def combined_parts(plays: Dataset) -> Parts:
    """Combined: halved times, and six decisions whatever happens."""
    bins = executed_bins(plays)
    halved = np.where(bins == NEVER_BIN, 1, bins // 2).astype(np.int32)
    time = np.zeros((len(plays), EVENTS), np.int32)
    time[:, :MAX_ELIMINABLE] = np.sort(halved, axis=1)
    rows = tables_at(plays, time, official=True)
    weight = np.ones((len(plays), EVENTS, MAX_ELIMINABLE), np.float32)
    weight[:, MAX_ELIMINABLE:] = 0
    table = np.arange(time.size, dtype=np.int32).reshape(time.shape)
    returns = np.ones(time.shape, np.float32)
    return rows.reshape(-1, *rows.shape[2:]), table, returns, np.repeat(halved[:, None], EVENTS, axis=1), time, weight


def choice_parts(plays: Dataset) -> Parts:
    """On the fly: the return is 1 for all, and nothing outweighs the few removals."""
    rows, actions, time, made = choices(plays)
    table = np.arange(len(rows), dtype=np.int32).reshape(made.shape)
    return rows, table, np.ones(made.shape, np.float32), actions, time, made[..., None].astype(np.float32)
