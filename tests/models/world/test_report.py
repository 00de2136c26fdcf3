"""The report of world models: seeds, bounds and what is missing are shown."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from iphyre_jax.files import read_json_object, replace_json
from iphyre_jax.models.storage import EVALUATION, VERSION, Comparison, WeightFiles
from iphyre_jax.models.world import compare, planning, storage
from iphyre_jax.models.world.reports import metrics
from iphyre_jax.models.world.reports.metrics import ERROR_BOUNDS, HORIZONS
from iphyre_jax.scenes import SPLITS
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.reports.report import seeds_cell


def _evaluation(seed: int, first: float) -> dict[str, Any]:
    """A made-up evaluation of "objects-100"; `first`: reward of the first attempt in each split."""
    config = compare.row_settings("objects-100", seed)
    measures = {
        "median error px": {"model": [float(seed + 1)] * len(HORIZONS)},
        "outcomes": {"right": 0.5 + 0.1 * seed},
        "calibration": {"one sigma": 0.7, "two sigma": 0.9, "uncertain": 0.5},
    }
    return {
        "schema": storage.RUNS.schema,
        "version": VERSION,
        "settings": config.to_json(),
        "steps": config.steps,
        "measures": storage.RUNS.measures,
        "columns": {"basic": measures},
        "planning": {split: _played(first) for split in PAPER_SPLITS},
    }


def _played(first: float) -> dict[str, Any]:
    return {"reward": [first, 900.0], "solved": [0.5, 1.0], "plans": 300}


def test_the_report_shows_seeds_bounds_and_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "planned", lambda agent, games, plans: _played(950.0))
    monkeypatch.setattr(metrics, "_frequent", lambda split: 0.65 if split == "basic" else 0.5)
    monkeypatch.setattr(metrics, "_bounded", lambda split: {name: [7.0] * len(HORIZONS) for name in ERROR_BOUNDS})
    where = Comparison(tmp_path, tmp_path / "world.md")
    earlier = {"measures": storage.RUNS.measures - 1}
    for seed, first, changes in ((0, 400.0, {}), (1, 500.0, earlier), (2, 600.0, {})):
        folder = where.published / f"objects-100-{seed}"
        folder.mkdir(parents=True)
        replace_json(folder / EVALUATION, {**_evaluation(seed, first), **changes})
    compare.write_report(where)
    text = where.out.read_text()
    assert "| objects-100 | 0 2 | 100 | 2000 | 128 |" in text
    assert "objects-100-1" in text
    assert "objects-100-2" not in text
    assert "| objects-100 | 2.00 ± 1.41 |" in text  # errors of 1 and 3 px
    assert text.count("| moves on as in the last 0.1 s | 7.00 | 7.00 |") == 1
    assert "| always the more frequent outcome of 100 other plays of each game | 65.0 | 50.0 |" in text
    assert "| objects-100 | 70 ± 0 / 90 ± 0 of 50 ± 0 |" in text
    assert "| objects-100, first | 500 ± 141 / 50 ± 0 % |" in text
    assert "| planner, exact simulator, first | 950 / 50 % |" in text


def test_a_bound_is_played_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    games: list[str] = []

    def play(agent: object, names: tuple[str, ...], plans: int) -> dict[str, Any]:
        del agent
        games.extend(names)
        return {**_played(1.0), "plans": plans}

    monkeypatch.setattr(planning, "planned", play)
    rows = planning.planning_bounds(tmp_path, 7)
    assert len(games) == 40 * len(rows)
    assert planning.planning_bounds(tmp_path, 7) == rows
    assert len(games) == 40 * len(rows)
    with pytest.raises(ValueError, match="settings: expected"):
        planning.planning_bounds(tmp_path, 8)


def test_the_more_frequent_outcome_is_that_of_other_plays(monkeypatch: pytest.MonkeyPatch) -> None:
    def plays(games: tuple[str, ...], each: int, seed: int, *_: int) -> SimpleNamespace:
        scene = np.repeat(np.arange(len(games)), each)
        solved = scene % 2 == 0 if seed == metrics.SEED else scene == 0  # the others: the first game alone is solved
        return SimpleNamespace(scene=scene, success=solved)

    monkeypatch.setattr(metrics, "official_plays", plays)
    monkeypatch.setattr(metrics, "judged_plays", lambda split: plays(SPLITS[split], metrics.PLAYS, metrics.SEED))
    assert metrics._frequent("basic") == pytest.approx(0.6)  # five games are not solved, and the first one is


def test_the_best_seed_ships(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: dict[str, storage.WorldModel] = {}
    monkeypatch.setattr(WeightFiles, "save", lambda files, folder, model: saved.update({model.name: model}))
    monkeypatch.setattr(
        storage, "trained_model", lambda folder: storage.WorldModel("", storage.RUNS.read_config(folder), (), {})
    )
    folders = [tmp_path / f"objects-100-{seed}" for seed in (0, 2, 1)]
    for folder, seed in zip(folders, (0, 2, 1), strict=True):
        storage.RUNS.create(folder, compare.row_settings("objects-100", seed))
        content = _evaluation(seed, 400.0)
        replace_json(folder / EVALUATION, {**content, "columns": {compare.CHOSEN_ON: content["columns"]["basic"]}})
    assert compare.ship(folders, tmp_path) == ["objects-100"]
    assert saved["objects-100"].config.seed == 2  # it has the largest share of right outcomes
    assert saved["objects-100"].origin["share"] == pytest.approx(0.7)
    whole = read_json_object(folders[0] / EVALUATION)
    replace_json(folders[0] / EVALUATION, {**whole, "steps": whole["steps"] // 2})
    with pytest.raises(ValueError, match=r"evaluation\.json: steps: expected those of a whole run$"):
        compare.ship(folders, tmp_path)
    replace_json(folders[0] / EVALUATION, {**whole, "columns": {}})
    with pytest.raises(ValueError, match=r"evaluation\.json: columns: expected unseen_basic"):
        compare.ship(folders, tmp_path)


def test_a_cell_without_seeds_is_empty() -> None:
    assert seeds_cell([]) == "-"
