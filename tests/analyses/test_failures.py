from iphyre_jax.analyses.failures import failure_source, is_subsequence
from iphyre_jax.analyses.shipped import policies

ROW = {"orders": [{"order": [0], "plan": [3, -1]}, {"order": [1, 0], "plan": [5, 2]}]}


def test_sources_of_failure_by_hand() -> None:
    assert failure_source((0,), ROW) == "timing"
    assert failure_source((1, 0), ROW) == "timing"
    assert failure_source((0, 1), ROW) == "order"
    assert failure_source((1,), ROW) == "selection"
    assert failure_source((), ROW) == "selection"
    assert failure_source((0,), {"orders": []}) == "impossible"


def test_subsequences() -> None:
    assert is_subsequence((), (1, 2))
    assert is_subsequence((1, 3), (1, 2, 3))
    assert not is_subsequence((3, 1), (1, 2, 3))
    assert not is_subsequence((1, 1), (1, 2))


def test_greedy_plans_of_shipped_policies_are_steps() -> None:
    (smooth,) = [policy for policy in policies() if policy.name == "ppo-i-smooth"]
    plan = smooth.games["support"]["plan"]
    assert smooth.greedy_plan("support") == [-1 if time is None else round(60 * time) for time in plan]
