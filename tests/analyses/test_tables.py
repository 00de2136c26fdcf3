"""Tables of the analyses, by hand and as they are published."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.analyses import attempts_rows, protocols, seeds
from iphyre_jax.analyses.claims import claims
from iphyre_jax.analyses.oracle import RATES, shipped
from iphyre_jax.analyses.shipped import policies
from iphyre_jax.cli.analyse import DOCUMENTS, Analyse, What
from iphyre_jax.files import read_json_object, replace_json
from iphyre_jax.kept_rows import read_row
from iphyre_jax.scenes import GAMES

RESULTS = Path(__file__).parents[2] / "docs" / "results"
RUNS = RESULTS / "runs"
ROWS = RESULTS / "analyses"


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
    rows = seeds.published(RUNS)
    found = claims(policies(), rows, shipped(10), counts)
    assert len({claim.text for claim in found}) == len(found) == 15
    assert all(claim.judgement.split(":")[0] in ("holds", "does not hold", "partly", "open") for claim in found)
    by_text = {claim.text: claim for claim in found}
    assert by_text["Compositional games are hardest"].judgement == "does not hold"  # the last ten places are multi-ball
    open_ones = {claim.text for claim in claims(policies(), rows, shipped(10), None) if claim.judgement == "open"}
    assert "Difficulty by sampling agrees with people (a negative rank correlation)" in open_ones


@pytest.mark.parametrize("what", ["slack", "failures", "people", "within-template", "games"])
def test_published_documents_are_those_of_what_ships(what: What) -> None:
    written = (RESULTS / f"{what}.md").read_text("utf-8").split("\n## Origin")[0]
    assert DOCUMENTS[what](Analyse(runs=RUNS), Console(quiet=True)) == written


def test_published_rows_are_those_of_what_ships() -> None:
    """A row of another policy, or of other weights, has to be computed anew."""
    for name in protocols.POLICIES:
        read_row(ROWS / "protocols" / f"{name}.json", protocols.settings(name))
    for fps in RATES:
        for name, (settings, _) in attempts_rows.specifications(fps).items():
            read_row(ROWS / f"attempts-{fps}fps" / f"{attempts_rows.file_stem(name)}.json", settings)


@pytest.mark.parametrize("what", ["attempts", "protocols"])
def test_published_documents_are_those_of_their_rows(what: What) -> None:
    written = (RESULTS / f"{what}.md").read_text("utf-8").split("\n## Origin")[0]
    assert DOCUMENTS[what](Analyse(rows=ROWS, written_only=True), Console(quiet=True)) == written


def test_differences_are_over_seeds() -> None:
    row = seeds.published(RUNS)["ppo-o"]
    each = [np.mean(one.scores("greedy", "unseen_basic")) - np.mean(one.scores("greedy", "basic")) for one in row.seeds]
    found = seeds.unseen_difference(row)
    assert (found.mean, found.seeds) == (pytest.approx(np.mean(each)), 5)
    half = 2.7764451 * np.std(each, ddof=1) / 5**0.5  # t of 4 degrees of freedom
    assert (found.low, found.high) == (pytest.approx(found.mean - half), pytest.approx(found.mean + half))


def test_seeds_that_are_missing_or_differ_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"runs: expected .*a2c-c/seed-\*, which `make results` publishes; there are"):
        seeds.published(tmp_path)
    shutil.copytree(RUNS / "a2c-c", tmp_path / "a2c-c")
    evaluation = tmp_path / "a2c-c" / "seed-1" / "evaluation.json"
    content = read_json_object(evaluation)
    kept = [game for game in content["games"] if game["game"] != "unseen_hole"]
    replace_json(evaluation, {**content, "games": kept})
    with pytest.raises(ValueError, match=r"seed-1: expected scores of the games of unseen_basic, they are not there"):
        seeds.published(tmp_path)
    shutil.rmtree(evaluation.parent)
    shutil.copytree(RUNS / "a2c-i" / "seed-1", evaluation.parent)
    with pytest.raises(ValueError, match=r"runs: expected seeds of one agent in .*a2c-c, their settings differ"):
        seeds.published(tmp_path)
