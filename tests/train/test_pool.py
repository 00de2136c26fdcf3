"""A pool of generated scenes: what is refused, how scenes are drawn, and a run with one resumes to the same bits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.data.generated import GeneratedScenes, load_generated, save_generated
from iphyre_jax.data.generated.canvas import Canvas
from iphyre_jax.data.generated.pool import scene_columns
from iphyre_jax.files import file_sum
from iphyre_jax.scenes import load_scene
from iphyre_jax.scenes.compile import topology_of
from iphyre_jax.train import collect, loop, pool, trainer
from iphyre_jax.train.pool import Curriculum, ScenePool, draw_scenes, open_pool, recorded, scene_weights, with_sum
from iphyre_jax.train.scenes import training_scenes
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.checks import GROUP
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import logs, runs
from tests.train.storage.test_runs import assert_same_tree

QUIET = Console(quiet=True)
SCENES = ("support", "hole", "fill", "support")  # in fill a bar moves: another topology


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pool of four basic games, each with a name and grade as generated scenes have."""
    canvas = Canvas.empty(len(SCENES))
    for row, game in enumerate(SCENES):
        canvas.write(row, load_scene(game))
    count = len(SCENES)
    columns = {
        "number": np.arange(count),
        "basic": np.zeros(count, np.int8),
        "distance": np.full(count, np.inf),
        "plans": np.full(count, 160, np.int16),
        "solved": np.full(count, 40, np.int16),
        **scene_columns(canvas),
    }
    path = tmp_path_factory.mktemp("pool") / "pool.npz"
    content = {"schema": "iphyre_jax/generated", "version": 1, "seed": 0, "scenes": count}
    save_generated(GeneratedScenes(columns, content), path)
    return path


@pytest.fixture(scope="module")
def tiny(file: Path) -> TrainConfig:
    return TrainConfig(
        games=("support", "hole"),
        scene_pool=str(file),
        pool_scenes=3,
        hidden_sizes=(8,),
        updates=3,
        episodes_per_scene=2 * GROUP,
        sampled_episodes=2,
        checkpoint_seconds=0.0,
        learner=PPO(minibatches=2),
    )


@pytest.mark.slow
def test_a_run_with_a_pool_resumes_to_the_same_bits(
    tiny: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = loop.train(tiny, tmp_path / "whole", QUIET)
    real, calls = collect.play_plans, iter(range(100))

    def interrupted(*arguments: Any, **options: Any) -> Any:
        if next(calls) == 2:  # the first update plays twice: its plans, and the greedy ones
            raise KeyboardInterrupt
        return real(*arguments, **options)

    with monkeypatch.context() as patched:
        patched.setattr(collect, "play_plans", interrupted)
        result = loop.train(tiny, tmp_path / "cut", QUIET)
    assert (result.finished, int(result.state.curriculum.played.sum())) == (False, 2)
    resumed = loop.resume(result.folder, QUIET)
    assert_same_tree(resumed.state, whole.state)
    assert resumed.state.curriculum.played.sum() == 2 * 3  # one group of each game's two, three updates
    lines = [logs.read(folder) for folder in (whole.folder, result.folder)]
    clockless = [[{k: v for k, v in one.items() if k not in trainer.TIMING_COLUMNS} for one in log] for log in lines]
    assert clockless[0] == clockless[1]
    config, state = runs.load(whole.folder, to_resume=True)
    assert config == replace(tiny, pool_sha256=file_sum(Path(tiny.scene_pool)))
    assert_same_tree(state, whole.state)


def test_a_run_is_not_resumed_with_another_pool(tiny: TrainConfig, file: Path, tmp_path: Path) -> None:
    changed = replace(tiny, pool_sha256="0" * 64)
    with pytest.raises(ValueError, match=r"^scene_pool: expected .* with SHA-256 0+, got [0-9a-f]+: it was changed$"):
        loop.train(changed, tmp_path / "run", QUIET)
    missing = replace(tiny, scene_pool=str(tmp_path / "none.npz"))
    with pytest.raises(FileNotFoundError, match=r"^scene_pool: expected a file of generated scenes, there is no"):
        loop.train(missing, tmp_path / "run", QUIET)
    with pytest.raises(ValueError, match=r"^pool_scenes: expected at most 4, as .* holds, got 5 "):
        loop.train(replace(tiny, pool_scenes=5), tmp_path / "run", QUIET)
    assert not (tmp_path / "run").exists()
    other = tmp_path / "other.npz"
    other.write_bytes(file.read_bytes())
    text = file.with_suffix(".json").read_text()
    other.with_suffix(".json").write_text(text.replace('"version": 1', '"version": 9'))
    with pytest.raises(ValueError, match='expected schema "iphyre_jax/generated", version 1'):
        open_pool(replace(tiny, scene_pool=str(other)))


def test_the_scenes_of_several_files_come_one_after_the_other(tiny: TrainConfig, file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.npz"
    save_generated(load_generated(file).select(np.array([3, 2, 1, 0])), other)
    both = replace(tiny, scene_pool=f"{other},{file}", pool_scenes=6)
    opened, first = open_pool(both), load_generated(file).scenes
    assert opened is not None
    assert opened.scenes == (*first[::-1], *first[:2])
    sums = {with_sum(replace(both, scene_pool=paths)).pool_sha256 for paths in (f"{other},{file}", f"{file},{other}")}
    assert len(sums) == 2
    with pytest.raises(ValueError, match=r"^pool_scenes: expected at most 8, as .*,.* holds, got 9 "):
        open_pool(replace(both, pool_scenes=9))
    with pytest.raises(FileNotFoundError, match=r"there is no .*none\.npz$"):
        with_sum(replace(both, scene_pool=f"{file},none.npz"))


def test_scenes_that_can_be_learned_from_are_drawn_more_often() -> None:
    known = Curriculum(np.array([0.0, 0.5, 1.0, 0.0], np.float32), np.array([3, 3, 3, 0], np.int32))
    weights = scene_weights(known, learnability=True)
    assert weights.sum() == pytest.approx(1)
    assert weights[3] == pytest.approx(pool.UNSEEN)  # the one never played
    assert weights[1] / weights[0] == pytest.approx((0.25 + pool.FLOOR) / pool.FLOOR)
    assert weights[0] == weights[2] > 0
    assert scene_weights(known, learnability=False).tolist() == [0.25] * 4
    assert scene_weights(known._replace(played=np.zeros(4, np.int32)), learnability=True).tolist() == [0.25] * 4


def test_the_running_success_follows_the_policy() -> None:
    before = Curriculum(np.array([0.0, 0.8], np.float32), np.array([0, 2], np.int32))
    after = recorded(before, np.array([1, 0]), np.array([[True, False], [True, True]]))
    assert after.success.tolist() == pytest.approx([1.0, 0.8 + pool.PACE * (0.5 - 0.8)])
    assert after.played.tolist() == [1, 3]
    assert before.played.tolist() == [0, 2]  # an interrupted update changes nothing


def test_an_update_has_few_topologies_and_no_scene_twice() -> None:
    kinds = np.arange(60) % 6
    many = ScenePool((), kinds)
    new = Curriculum(np.zeros(60, np.float32), np.zeros(60, np.int32))
    drawn = draw_scenes(many, new, 20, TrainConfig(), 1)
    assert len(set(drawn.tolist())) == 20
    assert len(set(kinds[drawn].tolist())) == TrainConfig.pool_topologies
    every = draw_scenes(many, new, 20, TrainConfig(pool_topologies=6), 1)
    assert len(set(kinds[every].tolist())) == 6
    assert drawn.tolist() == draw_scenes(many, new, 20, TrainConfig(), 1).tolist()
    assert drawn.tolist() != draw_scenes(many, new, 20, TrainConfig(), 2).tolist()
    assert len(draw_scenes(many, new, 50, TrainConfig(), 1)) == 50  # more than four topologies hold


def test_a_pool_takes_its_share_of_every_game(tiny: TrainConfig) -> None:
    assert (tiny.groups, tiny.pool_groups) == (2, 1)
    assert training_scenes(tiny, 1) == (("support", "hole"), GROUP)
    assert training_scenes(replace(tiny, pool_share=1.0), 1) == ((), GROUP)
    varied = replace(tiny, variations=4, episodes_per_scene=4 * GROUP, pool_share=0.5)
    scenes, episodes = training_scenes(varied, 1)
    assert (len(scenes), scenes[0], scenes[2], episodes) == (4, "support", "hole", GROUP)
    opened = open_pool(tiny)
    assert opened is not None
    assert [topology_of(scene) for scene in opened.scenes] == [topology_of(load_scene(game)) for game in SCENES[:3]]
    assert opened.kind.tolist() == [0, 0, 1]
