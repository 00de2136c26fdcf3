"""`make carry-over`: rows that differ in nothing but their scenes, a document of its rows, the forty played once."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.learning import carry_over, carry_over_policy, carry_over_rows
from benchmarks.learning.carry_over_document import ABOUT, CHOSEN, document
from benchmarks.learning.carry_over_policy import Policy, first_tries, greedy_scores, settings_of_row
from benchmarks.learning.carry_over_rows import Ranking
from iphyre_jax.attempts.policy_tries import JUDGED
from iphyre_jax.files import read_json_object
from iphyre_jax.models.outcome.storage import load_classifier
from iphyre_jax.scenes import GAMES, SPLITS, Scene, load_scene
from iphyre_jax.train.storage.pretrained import load_pretrained

LARGE_BATCH = {"scene_pool", "pool_scenes", "updates", "episodes_per_scene", "pool_topologies", "learner"}
DIFFER = {
    "default": set(),
    "variations": {"scene_pool"},
    "generated": {"variations", "pool_share"},
    "large-pool": {"scene_pool", "pool_scenes", "updates"},
    "large-batch": LARGE_BATCH,
    "small-pool": {"pool_scenes"},
    "uniform": {"curriculum"},
    "small-network": {"hidden_sizes"},
    "ensemble": set(),
    "refined-default": set(),
    "ranked": LARGE_BATCH,
    "refined": LARGE_BATCH,
    "confident": LARGE_BATCH,
    "refined-again": LARGE_BATCH,
    "pairs": LARGE_BATCH,
    "with-unions": LARGE_BATCH,
    "on-policy": LARGE_BATCH,
}


def forty(rewards: list[float]) -> dict[str, Any]:
    """A row of ten tries: the same best rewards in all games; solved from the second try on."""
    return {
        "best_reward": dict.fromkeys(GAMES, rewards),
        "solved": {game: [0.0, *[1.0] * 9] for game in GAMES},
        "faults": 0,
    }


def held(reward: float) -> dict[str, Any]:
    return {kind: {"reward": [reward, reward], "success": [1.0, 0.0]} for kind in ("unseen_basic", "held_out")}


@pytest.mark.parametrize("fps", [10, 60])
def test_rows_differ_in_one_thing(fps: int) -> None:
    table = carry_over_rows.rows(Path(), fps)
    base = table["default"]
    for name, config in table.items():
        config.check()
        assert config.fps == fps
        assert config.training_games == SPLITS["basic"]
        of = carry_over_rows.POLICIES_OF.get(name, name)
        own = carry_over_rows.UNIONS.scenes if of == carry_over_rows.WITH_UNIONS else 0  # before those of the pool
        most = own + carry_over_rows.TRAINED_ON
        assert config.pool_scenes <= most < own + carry_over_rows.POOL.scenes or not config.scene_pool
        differ = {one.name for one in fields(base) if getattr(base, one.name) != getattr(config, one.name)}
        assert differ == DIFFER[name]


@pytest.mark.parametrize("name", ["large-pool", "with-unions"])
def test_a_row_is_the_same_wherever_its_pool_lies(name: str) -> None:
    here, there = (carry_over_rows.rows(Path(root), 10)[name] for root in ("here", "there"))
    assert here != there
    assert settings_of_row(here) == settings_of_row(there)
    assert settings_of_row(here) != settings_of_row(replace(there, pool_sha256="1"))


@pytest.mark.parametrize(("name", "run", "count"), [("ensemble", "default", 4), ("pairs", "large-batch", 2)])
def test_policies_that_are_one_share_no_run(name: str, run: str, count: int) -> None:
    plain = carry_over_rows.rows(Path(), 10)[name]
    runs = [carry_over_rows.members(Path(), 10, name, plain, seed) for seed in range(5)]
    folders = [folder for one in runs for folder in one]
    assert folders == [Path(f"10fps/{run}") / f"seed-{seed}" for seed in range(5 * count)]
    assert [config.seed for one in runs for config in one.values()] == list(range(5 * count))


def test_other_rows_are_one_run() -> None:
    plain = carry_over_rows.rows(Path(), 60)["uniform"]
    assert carry_over_rows.members(Path(), 60, "uniform", plain, 3) == {
        Path("60fps/uniform/seed-3"): replace(plain, seed=3)
    }


def test_ranked_rows_have_the_policies_of_others() -> None:
    plain = carry_over_rows.rows(Path(), 10)
    for pair in (
        ("large-batch", "ranked"),
        ("large-batch", "refined"),
        ("large-batch", "confident"),
        ("large-batch", "refined-again"),
        ("default", "refined-default"),
        ("with-unions", "on-policy"),
    ):
        runs = [carry_over_rows.members(Path(), 10, name, plain[name], 2) for name in pair]
        assert runs[0] == runs[1] != {}
    config = plain["ranked"]
    rankers = [carry_over_rows.ranker_config(fps, count) for fps in (10, 60) for count in (0, 2)]
    assert [(one.fps, one.resets, one.epochs) for one in rankers] == [
        (10, 2, 80),
        (10, 2, 40),
        (60, 1, 80),
        (60, 1, 40),
    ]
    rows = [settings_of_row(config, ranker=ranker, ranking=Ranking(0)) for ranker in (None, *rankers)]
    rows += [
        settings_of_row(config, 1, rankers[1], ranking)
        for ranking in (Ranking(1), Ranking(2), Ranking(2, 0.1), Ranking(2, greedy_bonus=0))
    ]
    assert all(one != other for one, other in combinations(rows, 2))


@pytest.mark.further
def test_a_ranked_policy_plays_what_the_ranker_believes_in(monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = load_pretrained("ppo-i-objects")
    plain, ranked = (
        Policy(shipped.config, shipped.state, one, Ranking(0)) for one in (None, load_classifier("relations"))
    )
    assert settings_of_row(shipped.config) == plain.settings()
    assert plain.settings() != ranked.settings()
    games = ["support", "hole"]
    assert first_tries(plain, games)["success"] == greedy_scores(plain, games)["success"] == [1.0, 1.0]
    seen: list[int] = []

    def judge(scene: Scene, plans: Any) -> Any:
        seen.append(len(plans))
        return 1e-9 + np.nan_to_num(plans).max(axis=1) / 15  # the later, the better

    monkeypatch.setattr(carry_over_policy, "judge_of", lambda ranker: judge)
    assert first_tries(ranked, ["support"])["reward"][0] < first_tries(plain, ["support"])["reward"][0]
    assert seen == [JUDGED + 1]


def test_each_refinement_has_scenes_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    generated, files = (load_scene("support"),), []
    monkeypatch.setattr(carry_over, "scene_file", lambda root, of: files.append(of) or Path())
    monkeypatch.setattr(carry_over, "load_generated", lambda file: SimpleNamespace(scenes=generated))
    monkeypatch.setattr(carry_over, "FRESH_VARIATIONS", 12)
    fresh = [carry_over.fresh_scenes(Path(), number) for number in (1, 2, 3, 4, 6)]
    assert fresh[0] == fresh[1] == fresh[3] == generated
    assert 110 < len(fresh[2]) <= 121  # with variations; a few draws give no valid scene
    assert fresh[4][:2] == generated * 2
    assert set(fresh[4]) & set(fresh[2]) == set(generated)
    assert [(file.name, file.seed, file.kind) for file in files] == [
        ("pool-2", 2, "elements"),
        ("pool-3", 3, "elements"),
        ("pool-4", 4, "elements"),
        ("unions", 0, "unions"),
        ("pool-5", 5, "elements"),
        ("unions-3", 3, "unions"),
    ]
    every = [file for one in carry_over_rows.FRESH for file in one.files]
    assert len(set(every)) == len(every)
    assert all(file.seed != 1 for file in every)
    assert carry_over_rows.POOL not in files


def test_the_document_says_what_every_row_is() -> None:
    assert set(ABOUT) == {*carry_over_rows.ROWS, carry_over.SHIPPED, carry_over.SHIPPED_RANKED}
    assert set(CHOSEN) < set(ABOUT)


def test_the_document_of_two_seeds(tmp_path: Path) -> None:
    found = {"both-0": held(700.0), "both-1": held(800.0)}
    plain = document({10: {}, 60: found}, {10: {}, 60: {}}, ["both-2"], tmp_path / "none", {"commit": "c"})
    assert "| both | 2 | 750.0 [115, 1385] | 50.0 [50, 50] | 750.0 [115, 1385] | 50.0 [50, 50] |" in plain
    assert "Still missing: both-2." in plain
    assert "All forty games" not in plain
    assert "### 60 steps a second" in plain
    assert "### 10 steps a second" not in plain
    counter = tmp_path / "count.json"
    counter.write_text('{"runs": 1}')
    rows = {"both-0": forty([600.0, *[900.0] * 9]), "both-1": forty([800.0, *[1000.0] * 9])}
    text = document({10: {}, 60: found}, {10: {}, 60: rows}, [], counter, {})
    assert "This command has played them 1 time, each row once; `ppo-i-objects-ranked` was played again" in text
    assert f"| both | 2 {'| 700.0 [-571, 1971] ' * 5}| 0.0 [0, 0] |" in text
    assert f"| both | 700.0 [-571, 1971] {'| 950.0 [315, 1585] ' * 3}| 100.0 [100, 100] |" in text
    assert "| people | - | - | 844" in text
    assert "10 steps a second, reset 2" not in text


def test_the_forty_are_played_once_and_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    played: list[int] = []

    def play(agent: object, fps: int) -> dict[str, Any]:
        played.append(fps)
        return forty([500.0] * 10)

    monkeypatch.setattr(carry_over, "forty_row", play)
    for _ in range(2):
        carry_over.play_forty(tmp_path, {}, tmp_path)
    assert sorted(played) == [10, 10, 10, 60, 60, 60]  # random plans, and the shipped policy without and with rankers
    assert read_json_object(tmp_path / carry_over.COUNTER) == {"runs": 1}


def test_a_row_of_other_weights_is_refused_before_anything_is_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(carry_over, "forty_row", lambda agent, fps: forty([500.0] * 10))
    carry_over.play_forty(tmp_path, {}, tmp_path)
    row = tmp_path / "forty-10fps" / f"{carry_over.SHIPPED}.json"
    row.write_text(row.read_text().replace(read_json_object(row)["settings"]["sha256"], "0" * 64))
    for missing in (None, tmp_path / "forty-60fps" / "random plans.json"):
        if missing is not None:
            missing.unlink()
        with pytest.raises(ValueError, match=r"settings: expected others: sha256 0{40}\.\.\., not "):
            carry_over.play_forty(tmp_path, {}, tmp_path)
    assert read_json_object(tmp_path / carry_over.COUNTER) == {"runs": 1}
