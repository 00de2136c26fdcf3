"""Minari data sets: episodes are those of the plays, and their rewards add up to the paper's."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax.cli import main
from iphyre_jax.data import Dataset
from iphyre_jax.data.minari_export import _decisions, _sequences, export_minari
from iphyre_jax.rules import episode_reward
from tests.data.worlds import small

HAS_MINARI = importlib.util.find_spec("minari") is not None and importlib.util.find_spec("h5py") is not None
IN_ADVANCE = Dataset(**{**vars(small()), "poses": None})
REWARDS = episode_reward(small().success, small().removals, small().end_step, 60)


def test_rewards_add_up_to_those_of_the_paper() -> None:
    for episodes in (list(_decisions(IN_ADVANCE)), list(_sequences(small()))):
        np.testing.assert_allclose([episode.rewards.sum() for episode in episodes], REWARDS, rtol=0, atol=1e-9)
        assert [episode.infos["end_step"][0] for episode in episodes] == small().end_step.tolist()


def test_one_decision_ends_by_itself_and_a_sequence_that_fails_is_cut() -> None:
    assert not small().success.all()
    assert all(episode.terminated for episode in _decisions(IN_ADVANCE))
    assert [episode.terminated for episode in _sequences(small())] == small().success.tolist()


def test_sequences_remove_what_the_play_removed() -> None:
    for row, episode in enumerate(_sequences(small())):
        assert episode.actions.sum() == small().removals[row]
        assert len(episode.observations) == len(episode.actions) + 1 == -(-small().end_step[row] // 6) + 1
        if not small().removals[row]:
            continue
        decision, slot = np.argwhere(episode.actions)[0]
        block = small().scenes[small().game[row]].eliminable_blocks[slot]
        there = episode.observations[:, block].any(axis=-1)
        assert there.argmin() == decision + 1 or decision + 1 == len(episode.actions)


@pytest.mark.skipif(HAS_MINARI, reason="minari is there")
def test_without_minari_one_line_names_the_extra() -> None:
    missing = r"^a Minari data set needs the extra 'minari' .*pip install 'iphyre-jax\[minari\]'"
    with pytest.raises(ModuleNotFoundError, match=missing):
        export_minari(IN_ADVANCE, "iphyre/none-v0")


@pytest.mark.skipif(HAS_MINARI, reason="minari is there")
def test_the_command_tells_before_it_plays(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["collect", "hole", "--minari", "iphyre/none-v0"]) == 2
    assert "needs the extra 'minari'" in capsys.readouterr().err


@pytest.mark.skipif(not HAS_MINARI, reason="needs the extra minari; make test-minari runs it")
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("dataset", [IN_ADVANCE, small()], ids=["in advance", "sequences"])
def test_minari_reads_what_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dataset: Dataset) -> None:
    import minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    export_minari(dataset, "iphyre/small-v0")
    read = minari.load_dataset("iphyre/small-v0")
    assert read.total_episodes == len(dataset)
    for row, episode in enumerate(read.iterate_episodes()):
        np.testing.assert_allclose(episode.rewards.sum(), REWARDS[row], rtol=0, atol=1e-6)
        ended = dataset.poses is None or dataset.success[row]
        assert bool(episode.terminations[-1]) == ended != bool(episode.truncations[-1])
        assert episode.infos["steps"][0].tolist() == dataset.steps[row].tolist()
        assert read.action_space.contains(episode.actions[0])
    with pytest.raises(ValueError, match=r"^dataset_id: expected a new name, but Minari has a data set"):
        export_minari(dataset, "iphyre/small-v0")
    with pytest.raises(ValueError, match=r"^dataset_id: expected a name such as"):
        export_minari(dataset, "no version")
