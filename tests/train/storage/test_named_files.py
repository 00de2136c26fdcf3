"""Files that settings name: found where a run was moved to, and told by their sums, not their paths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.named_files import copy_scenes, with_present_files, without_paths

POOLED = TrainConfig(scene_pool="shipped,data/pool.npz", pool_sha256="1" * 64)
PREDICTED = replace(TrainConfig(strategy="on-the-fly"), prediction="models/world", prediction_sha256="2" * 64)


def test_a_scene_that_is_gone_is_the_copy(tmp_path: Path) -> None:
    own = tmp_path / "own.json"
    own.write_text("{}")
    config, run = TrainConfig(games=("hole", str(own))), tmp_path / "run"
    copy_scenes(run, config)
    assert with_present_files(run, config) == config
    own.unlink()
    assert with_present_files(run, config).games == ("hole", str(run / "scenes" / "1" / "own.json"))
    assert with_present_files(tmp_path / "other", config) == config  # no copy, no other path
    strange = replace(config, games=("\0", "x" * 5000))
    assert with_present_files(run, strange) == strange


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
    named = replace(PREDICTED, prediction="objects-unlimited")
    assert with_present_files(run, named) == named


def test_paths_whose_sums_are_known_do_not_tell_settings_apart() -> None:
    for config, other in (
        (POOLED, replace(POOLED, scene_pool="shipped,/elsewhere/pool.npz")),
        (PREDICTED, replace(PREDICTED, prediction="/elsewhere")),
        (TrainConfig(games=("hole", "a.json")), TrainConfig(games=("hole", "/b.json"))),
    ):
        assert without_paths(config) == without_paths(other)
    for config, other in (
        (POOLED, replace(POOLED, scene_pool="data/pool.npz,shipped")),
        (POOLED, replace(POOLED, pool_sha256="3" * 64)),
        (PREDICTED, replace(PREDICTED, prediction_sha256="3" * 64)),
        (TrainConfig(games=("hole", "a.json")), TrainConfig(games=("a.json", "hole"))),
        (replace(PREDICTED, prediction="zeros", prediction_sha256=""), replace(PREDICTED, prediction="perfect")),
    ):
        assert without_paths(config) != without_paths(other)
