"""Files that settings name: found where a run was moved to, and told by their sums, not their paths."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.named_files import copy_scenes, with_own_scenes, with_present_files, without_paths

POOLED = TrainConfig(scene_pool="shipped,data/pool.npz", pool_sha256="1" * 64)
PREDICTED = replace(TrainConfig(strategy="on-the-fly"), prediction="models/world", prediction_sha256="2" * 64)


def test_scenes_are_the_copies(tmp_path: Path) -> None:
    own = tmp_path / "own.json"
    own.write_text("{}")
    config, run = TrainConfig(games=("hole", str(own))), tmp_path / "run"
    settings = json.loads(json.dumps(config.to_json()))
    assert with_own_scenes(run, settings) == settings  # no copy, no other path
    copy_scenes(run, config)
    copy = str(run / "scenes" / "1" / "own.json")
    assert with_own_scenes(run, settings) == settings | {"games": ["hole", copy]}
    copy_scenes(run, replace(config, games=("hole", copy)))  # what is there stays
    strange: tuple[object, ...] = (None, [], {}, {"games": "x"}, {"games": [1]}, {"games": ["\0", "x" * 5000]})
    for other in strange:
        assert with_own_scenes(run, other) == other


def test_relative_paths_are_also_those_above_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = tmp_path / "project" / "runs" / "one"
    (run.parents[1] / "data").mkdir(parents=True)
    (run.parents[1] / "data" / "pool.npz").touch()
    (run.parents[1] / "models" / "world").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert with_present_files(run, POOLED).scene_pool == f"shipped,{run.parents[1] / 'data' / 'pool.npz'}"
    assert with_present_files(run, PREDICTED).prediction == str(run.parents[1] / "models" / "world")
    monkeypatch.chdir(run.parents[1])
    assert with_present_files(run, POOLED) == POOLED
    assert with_present_files(run, PREDICTED) == PREDICTED
    comma = Path(shutil.move(run.parents[1], tmp_path / "a,b")) / "runs" / "one"
    monkeypatch.chdir(tmp_path)
    assert with_present_files(comma, POOLED) == POOLED  # a comma stands between two files
    named = replace(PREDICTED, prediction="objects-unlimited")
    assert with_present_files(run, named) == named


def test_paths_whose_sums_are_known_do_not_tell_settings_apart() -> None:
    for config, other in (
        (POOLED, replace(POOLED, scene_pool="shipped,/elsewhere/pool.npz")),
        (PREDICTED, replace(PREDICTED, prediction="/elsewhere/world")),
        (TrainConfig(games=("hole", "a.json")), TrainConfig(games=("hole", "/b/a.json"))),
    ):
        assert without_paths(config) == without_paths(other)
    for config, other in (
        (POOLED, replace(POOLED, scene_pool="data/pool.npz,shipped")),
        (POOLED, replace(POOLED, pool_sha256="3" * 64)),
        (PREDICTED, replace(PREDICTED, prediction_sha256="3" * 64)),
        (TrainConfig(games=("hole", "a.json")), TrainConfig(games=("a.json", "hole"))),
        (TrainConfig(games=("hole", "a.json")), TrainConfig(games=("hole", "b.json"))),
        (replace(PREDICTED, prediction="zeros", prediction_sha256=""), replace(PREDICTED, prediction="perfect")),
    ):
        assert without_paths(config) != without_paths(other)
