"""Feasible orders: in which sequences of blocks a game can be solved, each with a plan that proves it.

An order is the blocks that a play removed before its end, by time. That an order was not found is no proof that it
cannot work, unless all plans were enumerated.
"""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.search import BATCH, LATEST, Plans, Tried, play_plans_of, with_distinct_steps
from iphyre_jax.rules import NEVER, TIME_LIMIT

BlockOrder = tuple[int, ...]  # plan slots in the order in which their blocks went

TIMINGS: Final = 4  # plans for each order that differs from a feasible one by a block or an exchange
SPREAD: Final = 0.3  # s, standard deviation of the other times there


def executed_order(plan: npt.NDArray[np.int64], steps: int) -> BlockOrder:
    """Return the slots that a plan (S,) removed in a play of so many steps, by time."""
    gone = np.flatnonzero((plan != NEVER) & (plan < steps))
    return tuple(gone[np.argsort(plan[gone], kind="stable")].tolist())


def possible_orders(blocks: int) -> list[BlockOrder]:
    """Return every sequence of different slots, the empty one first: 1957 with six blocks."""
    return [order for count in range(blocks + 1) for order in itertools.permutations(range(blocks), count)]


def feasible_orders(tried: Tried, most: int, seed: int) -> dict[BlockOrder, Plans]:
    """Return the orders in which a game can be solved, each with a proof plan (S,) that was decided in float64.

    First come the orders of what was tried before. Then random timings of each order not yet found, and timings near
    the proofs of orders that differ by one block more or less or by an exchange, as long as they find others.

    Args:
        tried: the plans that a search played, with their ends.
        most: further plays at most.
        seed: of the random numbers.
    """
    rng = np.random.default_rng([seed, 1])
    proofs: dict[BlockOrder, Plans] = {}
    _add(proofs, tried.plans[tried.success], tried.steps[tried.success])
    blocks = tried.plans.shape[1]
    every = possible_orders(blocks)
    grown: set[BlockOrder] = set()
    left = most
    while left > 0 and len(proofs) < len(every):
        near = [order for order in proofs if order not in grown]
        missing = [order for order in every if order not in proofs]
        if near:
            plans = np.concatenate([_near(rng, proofs[order], missing, order, tried.fps) for order in near])
            grown.update(near)
        else:
            plans = _random_timings(rng, missing, min(left, BATCH), blocks, tried.fps)
        plans = with_distinct_steps(plans)[:left]
        left -= max(len(plans), 1)
        if len(plans):
            _, success, steps = play_plans_of(tried.scene, plans, tried.fps, tried.resets)
            _add(proofs, plans[success], steps[success])
    return _decided(tried, proofs)


def _add(proofs: dict[BlockOrder, Plans], plans: Plans, steps: npt.NDArray[np.int64]) -> None:
    """Keep the first plan of each order; entries after the end are cut."""
    for plan, end in zip(plans, steps.tolist(), strict=True):
        proofs.setdefault(executed_order(plan, end), np.where(plan < end, plan, NEVER))


def _random_timings(rng: np.random.Generator, orders: list[BlockOrder], count: int, blocks: int, fps: int) -> Plans:
    """Return plans with random times for orders drawn at random, (count, blocks); half of them are bursts."""
    plans = np.full((count, blocks), NEVER)
    for row, picked in enumerate(rng.integers(0, len(orders), count)):
        order = orders[picked]
        late = rng.random() < 0.5
        times = rng.uniform(0, LATEST, len(order)) if late else rng.uniform(0, LATEST - 1) + rng.random(len(order))
        plans[row, list(order)] = np.sort(np.rint(times * fps).astype(np.int64) + 1)
    return plans


def _near(rng: np.random.Generator, proof: Plans, missing: list[BlockOrder], order: BlockOrder, fps: int) -> Plans:
    """Return plans of missing orders, with times as in a proof of a neighbouring one."""
    last, plans = round(TIME_LIMIT * fps) - 1, []
    wanted = set(missing)
    for other in _neighbouring(order, len(proof)):
        if other not in wanted:
            continue
        for _ in range(TIMINGS):
            plan = np.full(len(proof), NEVER)
            steps = np.sort(proof[list(order)])
            if len(other) > len(order):  # the new block's time lies between its neighbours, or near
                at = next(k for k, slot in enumerate(other) if slot not in order)
                low = int(steps[at - 1]) if at else 0
                high = int(steps[at]) if at < len(steps) else last
                steps = np.insert(steps, at, rng.integers(low, max(min(high, low + 2 * fps), low + 1) + 1))
            elif len(other) < len(order):
                steps = np.delete(steps, next(k for k, slot in enumerate(order) if slot not in other))
            moved = np.rint(rng.normal(0, SPREAD * fps, len(steps))).astype(np.int64) * (rng.random(len(steps)) < 0.3)
            plan[list(other)] = np.sort(np.clip(steps + moved, 1, last))
            plans.append(plan)
    return np.array(plans, np.int64).reshape(-1, len(proof))


def _neighbouring(order: BlockOrder, blocks: int) -> list[BlockOrder]:
    """Return the orders with one block more, one less, or two neighbours exchanged."""
    more = [
        (*order[:at], slot, *order[at:]) for slot in range(blocks) if slot not in order for at in range(len(order) + 1)
    ]
    less = [(*order[:at], *order[at + 1 :]) for at in range(len(order))]
    exchanged = [(*order[:k], order[k + 1], order[k], *order[k + 2 :]) for k in range(len(order) - 1)]
    return [*more, *less, *exchanged]


def _decided(tried: Tried, proofs: dict[BlockOrder, Plans]) -> dict[BlockOrder, Plans]:
    """Return the orders whose proof also solves in float64, in that order of blocks; shortest first."""
    if not proofs:
        return {}
    plans = np.array(list(proofs.values()))
    _, success, steps = play_plans_of(tried.scene, plans, tried.fps, tried.resets, "float64")
    kept: dict[BlockOrder, Plans] = {}
    _add(kept, plans[success], steps[success])
    return dict(sorted(kept.items(), key=lambda item: (len(item[0]), item[0])))
