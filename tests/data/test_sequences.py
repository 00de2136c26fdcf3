"""Sequences: tables built again from poses equal those of the official class, frame by frame."""

from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import observation_table
from iphyre_jax.compat import IPHYRE
from iphyre_jax.data import Dataset, collect, save_dataset, tables
from iphyre_jax.data.labels import PlayProtocol, play_poses
from iphyre_jax.data.official_files import drawn_times
from iphyre_jax.observations.official import LENGTH_COLUMNS
from iphyre_jax.scenes import load_scene
from tests.data.worlds import small


def clicks(dataset: Dataset, row: int) -> list[list[float]]:
    scene = dataset.scenes[dataset.game[row]]
    centres = scene.blocks.mean(axis=1)[list(scene.eliminable_blocks)].tolist()
    times = drawn_times(dataset)[row].tolist()
    return [[*centre, time] for centre, time in zip(centres, times, strict=False) if time]


def test_tables_equal_those_of_the_official_class(tmp_path: Path) -> None:
    """The first play of each kind, in the first reset of a space, as `small` is played."""
    chosen = [int(np.flatnonzero(small().success == solved)[0]) for solved in (True, False)]
    ours = tables(small().select(chosen))
    for number, row in enumerate(chosen):
        simulator = IPHYRE(small().scenes[small().game[row]])
        simulator.collect_seq_data(str(tmp_path / str(number)), [clicks(small(), row)], images=False)
        theirs = np.load(tmp_path / str(number) / simulator.game / "0" / "vectors.npy")
        np.testing.assert_array_equal(ours[number], theirs)
        assert (theirs[-1] == 0).all() == small().success[row]


def test_a_removed_block_is_gone_in_the_frame_of_its_removal() -> None:
    """A block that goes before step 12 is missing in frame 2, which is taken after that removal; an agent sees it."""
    one = small().select([0])
    steps = np.full((1, 6), -1, np.int16)
    steps[0, 1] = 12
    other = Dataset(**{**vars(one), "steps": steps, "success": np.array([False]), "end_step": np.array([900])})
    block = one.scenes[0].eliminable_blocks[1]
    for official, last in ((True, 1), (False, 2)):
        there = tables(other, official=official)[0, :, block].any(axis=-1)
        assert there.tolist() == [True] * (last + 1) + [False] * (149 - last)


def test_what_an_agent_sees_stays_after_the_end() -> None:
    solved = small().select(small().success)
    seen = tables(solved, official=False)
    assert (seen[:, -1].any(axis=-1)).any(axis=-1).all()
    start = observation_table(["hole"])[0, :108].reshape(12, 9)
    rows = seen[0, 0].astype(np.float32)
    rows[:, :LENGTH_COLUMNS] /= 600
    np.testing.assert_allclose(rows.clip(0, 1), start, rtol=1e-6)


def test_float32_poses_are_near(tmp_path: Path) -> None:
    rough = Dataset(**{**vars(small()), "poses": small().poses.astype(np.float32)})
    np.testing.assert_allclose(tables(rough), tables(small()), rtol=0, atol=1e-3)
    save_dataset(rough, tmp_path / "rough.npz")
    assert (tmp_path / "rough.npz").stat().st_size < 150_000


def test_poses_after_k_frames_are_those_of_a_play_stopped_there() -> None:
    """Frame 0 is the start, and no frame is shifted by one."""
    scene = load_scene("hole")
    poses = play_poses([scene], np.zeros(1, int), np.full((1, 6), -1), PlayProtocol())
    assert poses.shape == (1, 150, 1, 3)
    np.testing.assert_array_equal(poses[0, 0, 0, :2], scene.balls[0, :2])
    fallen = poses[0, 1, 0, 1] - poses[0, 0, 0, 1]
    assert 0 < fallen < 600 * 0.1**2  # 6 steps of free fall or rest, px


def test_without_sequences_there_are_no_tables() -> None:
    with pytest.raises(ValueError, match="dataset: expected one with sequences"):
        tables(collect(["hole"], successes=1, failures=0))
