"""The document of difficulty names the seeds that its columns are of."""

from __future__ import annotations

from iphyre_jax.analyses import difficulty
from iphyre_jax.scenes import GAMES


def test_a_column_names_its_seed() -> None:
    """Seed 0 lacks a game: the first whole seed is the second."""
    row = {"to_successes": 777, "to_failures": 800, "solved": 50, "plays": 777}
    whole = dict.fromkeys(GAMES, row)
    text = difficulty.document({10: [dict.fromkeys(GAMES[1:], row | {"to_successes": 1}), whole]})
    assert "Still missing, in whole or in part: seed 0." in text
    assert "| game | seed 1 | both, seed 1 | mean of 1 seeds |" in text
    assert "Spearman with people, seed 1" in text
    assert "| hole | 777 | 800 | 777 |" in text


def test_a_count_that_the_cap_ended_says_so() -> None:
    row = {"to_successes": 777, "to_failures": 800, "solved": 50, "plays": 777}
    whole, capped = dict.fromkeys(GAMES, row), dict.fromkeys(GAMES, row) | {"hole": row | {"to_successes": None}}
    text = difficulty.document({10: [whole, capped]})
    assert "| hole | 777 | 800 | over 10,388 |" in text
    assert "| Basic | over 914 |" in text
    assert "| Noisy | 777 |" in text
    assert "| hole | over 20,000 | over 20,000 | over 20,000 |" in difficulty.document({10: [capped]})
