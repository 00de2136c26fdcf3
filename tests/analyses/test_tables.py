import numpy as np

from iphyre_jax.analyses import attempts_rows, protocols
from iphyre_jax.analyses.claims import claims
from iphyre_jax.analyses.oracle import shipped
from iphyre_jax.analyses.shipped import policies
from iphyre_jax.scenes import GAMES


def test_protocols_by_hand() -> None:
    sampled = np.tile(np.array([[0.0, 10.0, 0.0, 0.0, 0.0]]), (2, 4))  # two games, 20 episodes, one in five scores
    found = protocols.protocol_scores(np.array([7.0, 9.0]), sampled)
    assert [scores.mean() for scores in found.values()] == [8.0, 2.0, 2.0, 10.0, 10.0]
    assert [len(scores) for scores in found.values()] == [1, 20, 1, 4, 4]


def test_best_of_attempts_is_at_least_best_of_evaluations() -> None:
    sampled = np.random.default_rng(0).normal(size=(40, 100))
    scores = list(protocols.protocol_scores(np.zeros(40), sampled).values())
    assert (scores[4] >= scores[3]).all()
    assert scores[3].mean() > scores[2].mean()


def test_table_of_attempts_says_what_is_missing() -> None:
    row = {
        "solved": {game: [0.5, 1.0, 1.0, 1.0, 1.0] for game in GAMES},
        "best_reward": {game: [400.0, 900.0, 900.0, 900.0, 910.0] for game in GAMES},
    }
    two = {name: {game: values[:2] for game, values in column.items()} for name, column in row.items()}
    text = attempts_rows.document({60: {"an agent": row, "of two": two}}, {60: ["another"]})
    assert "Still missing: another." in text
    assert "| an agent | 50.0 [50, 50] | 100.0 [100, 100] | 100.0 [100, 100] | - | - | - | 910.0 |" in text
    assert "| of two | 50.0 [50, 50] | 100.0 [100, 100] | - | - | - | - |" in text
    assert text.count("| of two |") == 1  # AUCCESS@5 needs five attempts


def test_claims_are_complete_and_judged() -> None:
    counts = {game: {"to_successes": 100 + place} for place, game in enumerate(GAMES)}
    found = claims(policies(), shipped(10), counts)
    assert len({claim.text for claim in found}) == len(found) == 15
    assert all(claim.judgement.split(":")[0] in ("holds", "does not hold", "partly", "open") for claim in found)
    by_text = {claim.text: claim for claim in found}
    assert by_text["Compositional games are hardest"].judgement == "does not hold"  # the last ten places are multi-ball
    open_ones = {claim.text for claim in claims(policies(), shipped(10), None) if claim.judgement == "open"}
    assert "Difficulty by sampling agrees with people" in open_ones
