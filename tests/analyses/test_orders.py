import numpy as np
import pytest

from iphyre_jax import load_scene, simulate
from iphyre_jax.analyses.orders import _near, _neighbouring, executed_order, feasible_orders, possible_orders
from iphyre_jax.analyses.search import Tried


def test_executed_order_is_by_time_and_ends_with_the_play() -> None:
    plan = np.array([50, -1, 3, 80, 20])
    assert executed_order(plan, 60) == (2, 4, 0)
    assert executed_order(plan, 50) == (2, 4)  # a removal before step 50 does not happen in 50 steps, 0 to 49
    assert executed_order(np.array([-1, -1]), 60) == ()


@pytest.mark.parametrize(("blocks", "count"), [(2, 5), (3, 16), (6, 1957)])
def test_number_of_possible_orders(blocks: int, count: int) -> None:
    orders = possible_orders(blocks)
    assert len(orders) == len(set(orders)) == count
    assert orders[0] == ()


def test_neighbouring_orders() -> None:
    assert set(_neighbouring((0, 1), 3)) == {(2, 0, 1), (0, 2, 1), (0, 1, 2), (0,), (1,), (1, 0)}
    assert set(_neighbouring((), 2)) == {(0,), (1,)}


def test_plans_near_a_proof_have_the_missing_orders() -> None:
    proof = np.array([5, 9, -1])
    wanted = [(0, 2, 1), (1, 0)]
    plans = _near(np.random.default_rng(0), proof, wanted, (0, 1), 10)
    orders = {executed_order(plan, 150) for plan in plans if len(set(plan[plan >= 0])) == (plan >= 0).sum()}
    assert orders <= set(wanted)
    assert orders


def test_proofs_solve_the_game_in_their_order() -> None:
    tried = Tried(load_scene("support"), 10, 2)
    tried.play(np.array([[8, 14]]))
    found = feasible_orders(tried, 300, 0)
    assert set(found) == {(0, 1), (1, 0)}  # neither block alone lets the ball fall
    played = simulate("support", np.array(list(found.values())), fps=10, resets=2, dtype="float64")
    assert played.success.all()
    for order, plan, steps in zip(found, found.values(), played.steps.tolist(), strict=True):
        assert executed_order(plan, steps) == order
