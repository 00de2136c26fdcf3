"""Plays as sequences of decisions: tables, returns, actions. The faults of the official labels stand in `coded`.

N plays, T decisions at most, M tables.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays.inputs import scene_rows
from iphyre_jax.models.sequence import coded
from iphyre_jax.models.sequence.decisions import (
    Parts,
    centres,
    choices,
    decisions,
    executed_bins,
    ordered,
    rest,
    seen_tables,
    slot_objects,
)
from iphyre_jax.models.sequence.networks import END
from iphyre_jax.models.sequence.settings import EVENTS, SequenceConfig
from iphyre_jax.rules import FRAMES
from iphyre_jax.scenes import MAX_ELIMINABLE, SPLITS

BASIC_SHARE: Final = 0.5  # of drawn plays, where there are variations

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]


class SequenceData(NamedTuple):
    """N plays as sequences."""

    tables: jax.Array | Floats  # (M, 12, 9) lengths / 600, flags and pair numbers as they are
    centres: jax.Array | Floats  # (S, 6, 2) of the slots' blocks / 600
    scene: jax.Array | Ints  # (N,)
    table: jax.Array | Ints  # (N, T), or (N, 1) if one table serves all decisions
    returns: jax.Array | Floats  # (N, T) rest of the reward / 1000
    actions: jax.Array | Ints  # (N, T, A), see `networks.Sequences`
    time: jax.Array | Ints  # (N, T) tenths of a second
    weight: jax.Array | Floats  # (N, T, K) in the loss, of each of the K choices of a decision; 0: not learned
    length: jax.Array | Ints  # (N,) decisions made
    share: jax.Array | Floats  # (N,) how often a play is drawn, 1 in sum


def episodes(plays: Dataset, config: SequenceConfig) -> SequenceData:
    """The plays of a data set as a model of these settings learns them; those on the way need poses."""
    if config.coded_labels:
        parts = {"in-advance": coded.plan_parts, "combined": coded.combined_parts, "on-the-fly": coded.choice_parts}
    else:
        parts = {"in-advance": _plan_parts, "combined": _combined_parts, "on-the-fly": _choice_parts}
    events = config.form == "events"
    built = _event_parts(plays, config) if events else parts[config.strategy](plays)
    rows, table, returns, actions, time, weight = built
    if config.form == "plans":  # slots without a block are not learned
        weight = weight * (slot_objects(plays.scenes)[plays.game] != END)[:, None]
    length = np.maximum((weight.sum(axis=-1) > 0).sum(axis=1), 1).astype(np.int32)
    return SequenceData(
        tables=rows,
        centres=centres(plays.scenes),
        scene=np.asarray(plays.game, np.int32),
        table=table.astype(np.int32),
        returns=returns.astype(np.float32),
        actions=actions.astype(np.int32),
        time=time.astype(np.int32),
        weight=weight.astype(np.float32),
        length=length,
        share=shares(plays, config),
    )


def shares(plays: Dataset, config: SequenceConfig) -> Floats:
    """How often each play is drawn, (N,), 1 in sum; see `SequenceConfig.solved_share`."""
    weight = np.ones(len(plays))
    if config.solved_share:
        count = np.bincount(plays.success, minlength=2)
        kind = np.array([1 - config.solved_share, config.solved_share])
        weight = (kind / np.maximum(count, 1))[plays.success.astype(int)]
    if config.data == "large":  # the games themselves and their variations
        own = np.isin(plays.game, [k for k, scene in enumerate(plays.scenes) if scene.name in SPLITS["basic"]])
        weight *= np.where(own, BASIC_SHARE / weight[own].sum(), (1 - BASIC_SHARE) / max(weight[~own].sum(), 1e-9))
    return np.asarray(weight / weight.sum(), np.float32)


def _plan_parts(plays: Dataset) -> Parts:
    """In advance: one decision, the times of all slots."""
    zero = np.zeros((len(plays), 1), np.int32)
    weight = np.ones((len(plays), 1, MAX_ELIMINABLE), np.float32)
    start = scene_rows(plays.scenes), plays.game[:, None]
    return *start, rest(plays, zero, zero), executed_bins(plays)[:, None], zero, weight


def _event_parts(plays: Dataset, config: SequenceConfig) -> Parts:
    """Ours: which object goes next and after how long; in advance the start serves all decisions."""
    order, when, count = ordered(plays)
    before, time, made = decisions(plays)
    objects = np.take_along_axis(slot_objects(plays.scenes)[plays.game], order, axis=1)
    actions = np.full((len(plays), EVENTS, 2), END, np.int32)
    actions[:, :-1, 0] = np.where(np.arange(MAX_ELIMINABLE) < count[:, None], objects, END)
    actions[..., 1] = 0
    gaps = np.clip(when - time[:, :-1], 0, FRAMES - 1)
    actions[:, :-1, 1] = np.where(np.arange(MAX_ELIMINABLE) < count[:, None], gaps, 0)
    weight = np.stack([made, made & (actions[..., 0] != END)], axis=-1).astype(np.float32)
    if config.strategy == "in-advance":
        rows, table = scene_rows(plays.scenes), plays.game[:, None]
    else:
        rows, table = seen_tables(plays, before, time, made)
    return rows, table, rest(plays, np.minimum(before, count[:, None]), time), actions, time, weight


def _combined_parts(plays: Dataset) -> Parts:
    """Combined: at the start and after each removal, the times of the slots whose blocks are still there."""
    before, time, made = decisions(plays)
    bins = executed_bins(plays)
    actions = np.repeat(bins[:, None], EVENTS, axis=1)
    order, _, _ = ordered(plays)
    rank = np.argsort(order, axis=1)  # the how-many-eth each slot goes
    weight = made[..., None] & (rank[:, None] >= before[..., None])
    rows, table = seen_tables(plays, before, time, made)
    return rows, table, rest(plays, before, time), actions, time, weight.astype(np.float32)


def _choice_parts(plays: Dataset) -> Parts:
    """On the fly: every 0.1 s nothing or a slot; nothing and removals have the same weight in sum."""
    rows, actions, time, made = choices(plays)
    bins = executed_bins(plays)
    removed = (bins[:, None] < time[..., None]).sum(axis=-1).astype(np.int32)
    acts = made & (actions[..., 0] > 0)
    weight = np.where(acts, (made & ~acts).sum() / max(acts.sum(), 1), made).astype(np.float32)
    table = np.arange(rows.shape[0], dtype=np.int32).reshape(made.shape)
    return rows, table, rest(plays, removed, time), actions, time, weight[..., None]
