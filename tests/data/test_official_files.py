"""Official files: written and read back, and refused if they hold something else."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax import plan_to_steps
from iphyre_jax.data import Dataset, collect, drawn_times, tables, verify
from iphyre_jax.data.labels import PlayProtocol
from iphyre_jax.data.official_files import action_lists, load_official, save_official
from iphyre_jax.data.plays_io import dataset_from_plays, read_player_lines, write_player_lines
from iphyre_jax.scenes import Limits, load_scene
from iphyre_jax.viewer.plays import Play
from tests.data.worlds import small


def by_row(dataset: Dataset) -> list[tuple[object, ...]]:
    columns = (dataset.game, dataset.success, dataset.end_step, dataset.removals)
    return sorted(
        (*values, *times) for *values, times in zip(*columns, np.nan_to_num(dataset.times).tolist(), strict=True)
    )


def test_action_lists_and_sequences_round_trip(tmp_path: Path) -> None:
    save_official(small(), tmp_path)
    assert np.load(tmp_path / "hole" / "succeed_actions.npy").shape == (6, 9)
    vectors = np.load(tmp_path / "support" / "11" / "vectors.npy")
    last = small().select((small().game == 1) & ~small().success).select([5])
    np.testing.assert_array_equal(vectors, tables(last)[0])
    read = load_official(tmp_path)
    assert [entry["other_labels"] for entry in read.manifest["scenes"]] == [0, 0]
    for one, other in zip(by_row(read)[:3], by_row(small())[:3], strict=True):
        assert one[:4] == other[:4]
    assert sorted(read.end_step.tolist()) == sorted(small().end_step.tolist())
    for name in ("succeed_actions.npy", "fail_actions.npy"):
        (tmp_path / "hole" / name).unlink()
    clicked = load_official(tmp_path, games=["hole"])
    assert sorted(clicked.end_step.tolist()) == sorted(small().of_game("hole").end_step.tolist())
    assert not verify(clicked)


@pytest.mark.parametrize("distribution", ["official", "uniform15", pytest.param("mixed", marks=pytest.mark.further)])
def test_drawn_times_give_the_steps_that_were_played(distribution: Any) -> None:
    one = collect(["support", "hole"], successes=20, failures=20, distribution=distribution)
    np.testing.assert_array_equal(plan_to_steps(drawn_times(one), one.fps, one.manifest["rule"]), one.steps)


def test_drawn_times_are_exact_again() -> None:
    instants = np.arange(0, 7.0, 0.1)
    one = Dataset(**{**vars(small()), "times": np.where(instants, instants, np.nan).astype(np.float32)[:, None]})
    np.testing.assert_array_equal(drawn_times(one)[:, 0], instants)


def test_times_after_the_end_are_masked_in_lists_only() -> None:
    early = Dataset(**{**vars(small()), "end_step": np.full(24, 120, np.int16)})
    rows, times = action_lists(early), drawn_times(early)
    assert (times > 2).any()
    np.testing.assert_array_equal(rows[:, :6], np.where(times > 2, 0, times))
    np.testing.assert_allclose(rows[:, 8], 2)


BROKEN = {
    "pickle": (np.array([{"a": 1}], object), "expected an array of numbers"),
    "shape": (np.zeros((3, 4)), r"expected numbers of shape \(n, 9\)"),
    "times": (np.full((3, 9), 99.0), "expected times from 0 to 15 s"),
    "no block": (
        np.array([[1.0, 2.0, 0, 0, 3.0, 0, 1, 2, 5]]),
        "expected 0 after the times of its 4 eliminable blocks",
    ),
    "text": (np.array([["a"] * 9]), "expected numbers of shape"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_other_files_are_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = BROKEN[case]
    (tmp_path / "hole").mkdir()
    for name in ("succeed_actions.npy", "fail_actions.npy"):
        np.save(tmp_path / "hole" / name, content, allow_pickle=True)
    with pytest.raises(ValueError, match=message) as caught:
        load_official(tmp_path)
    assert "\n" not in str(caught.value)


LINE = {"player": "ann", "game": "hole", "episode": 2, "actions": [], "reward": -15.0}
CENTRE = load_scene("hole").blocks.mean(axis=1)[load_scene("hole").eliminable_blocks[1]].tolist()


def test_a_folder_of_official_files_may_hold_other_things(tmp_path: Path) -> None:
    save_official(small(), tmp_path)
    (tmp_path / ".git").mkdir()
    assert len(load_official(tmp_path)) == len(small())
    np.save(tmp_path / small().scenes[0].name / "fail_actions.npy", np.array([]))  # an empty list, as others write it
    assert len(load_official(tmp_path)) < len(small())
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"^folder: expected a folder for a game in "):
        load_official(tmp_path / "empty")


def test_fewer_sequences_replace_more(tmp_path: Path) -> None:
    dataset = small()
    own = dataset.select(dataset.game == 0)
    save_official(own, tmp_path)
    save_official(own.select(np.arange(len(own)) < 2), tmp_path)
    kept = {path.name for path in (tmp_path / own.scenes[0].name).iterdir() if path.is_dir()}
    assert kept == {"0", "1"}
    save_official(replace(own, poses=None), tmp_path)
    assert not [path for path in (tmp_path / own.scenes[0].name).iterdir() if path.is_dir()]


def test_player_lines_round_trip(tmp_path: Path) -> None:
    result = {"solved": True, "steps": 261, "eliminations": 2, "reward": 975.65}
    play = Play("ann", load_scene("hole"), (-1, -1, 83, 32), result=result)
    late = Play("ann", load_scene("hole"), (400, -1, 83, 32), result=result)
    write_player_lines(tmp_path / "lines.json", [play, late])
    lines = read_player_lines(tmp_path / "lines.json")
    assert [line.play.plan for line in lines] == [play.plan, play.plan]  # a removal after the end is no click
    assert [(line.episode, line.play.resets, line.reward) for line in lines] == [(0, 1, 975.65), (1, 2, 975.65)]
    made = dataset_from_plays([line.play for line in lines])
    assert (made.success.tolist(), made.end_step.tolist(), made.removals.tolist()) == ([True] * 2, [261] * 2, [2] * 2)
    assert made.draw.tolist() == [0, 1]
    assert not verify(made)


def test_times_of_a_play_give_its_steps(tmp_path: Path) -> None:
    """All steps at 60 a second but the first, which the zeros of an official list take."""
    steps = np.random.default_rng(0).permutation(894)[:892].reshape(-1, 4) + 6
    made = dataset_from_plays([Play("ann", load_scene("hole"), tuple(map(int, row))) for row in steps])
    np.testing.assert_array_equal(made.steps[:, :4], steps)
    np.testing.assert_array_equal(PlayProtocol(60).steps(made.times), made.steps)
    save_official(made, tmp_path)
    read = load_official(tmp_path)
    order = np.argsort(~made.success, kind="stable")
    executed = made.steps[order] < made.end_step[order][:, None]
    np.testing.assert_array_equal(read.steps[executed], made.steps[order][executed])
    np.testing.assert_array_equal(read.end_step, made.end_step[order])


def test_a_removal_before_the_first_step_goes_before_the_second() -> None:
    made = dataset_from_plays([Play("ann", load_scene("hole"), (0, -1, 5, 5))])
    assert made.steps[0, :4].tolist() == [1, -1, 5, 6]
    assert not verify(made)


def test_a_click_goes_before_the_step_of_its_clock(tmp_path: Path) -> None:
    """Times are sums of 1/60, as the official loop adds them."""
    now = sum([1 / 60] * 100, start=0.0)
    line = LINE | {"actions": [[*CENTRE, now]], "player": ""}
    (tmp_path / "lines.json").write_text(json.dumps(line) + "\n\n")
    (read,) = read_player_lines(tmp_path / "lines.json")
    assert read.play.plan == (-1, 100, -1, -1)
    assert (read.play.agent, read.play.resets) == ("nobody", 3)


WRONG_LINES = {
    "json": ("{", "line 1: expected JSON"),
    "fields": ({"player": "ann"}, "line 1: expected an object with the fields player, game"),
    "player": (LINE | {"player": "a\nb"}, "player: expected a printable name"),
    "episode": (LINE | {"episode": -1}, "episode: expected a whole number"),
    "reward": (LINE | {"reward": None}, "reward: expected a number"),
    "game": (LINE | {"game": ["hole"]}, "game: expected the name of a game"),
    "huge reward": (LINE | {"reward": 10**400}, "line 1: reward: expected a number, got an integer of 1329 bits"),
    "huge time": (LINE | {"actions": [[*CENTRE, 10**399]]}, "line 1: actions: expected clicks .* of finite numbers"),
    "no game": (LINE | {"game": "holee"}, r"lines.json: line 1: game: expected .*, got 'holee' \(did you mean hole"),
    "scene file": (LINE | {"game": "/etc/hosts"}, "line 1: game: expected the name of a game, got '/etc/hosts'"),
    "click": (LINE | {"actions": [[1, 2]]}, "actions: expected clicks"),
    "miss": (LINE | {"actions": [[1, 2, 3]]}, "actions: expected a click on a block"),
    "again": (LINE | {"actions": [[*CENTRE, 1], [*CENTRE, 2]]}, "actions: expected a click on a block that is left"),
    "time": (LINE | {"actions": [[*CENTRE, 15]]}, "actions: expected times from 0 to below 15 s"),
}


@pytest.mark.parametrize("case", WRONG_LINES)
def test_wrong_lines_are_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = WRONG_LINES[case]
    (tmp_path / "lines.json").write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ValueError, match=message) as caught:
        read_player_lines(tmp_path / "lines.json")
    assert "\n" not in str(caught.value)


def test_plays_of_two_rates_make_no_data_set() -> None:
    plays = [Play("ann", load_scene("hole"), (-1,) * 4, fps=fps) for fps in (10, 60)]
    with pytest.raises(ValueError, match="plays: expected plays of one rate, got 10, 60"):
        dataset_from_plays(plays)


def test_lists_have_the_columns_of_their_game(tmp_path: Path) -> None:
    large = load_scene("support", Limits(16, 8))
    both = collect(["hole", replace(large, name="mine")], successes=2, failures=2)
    assert both.times.shape[1] == 8
    save_official(both, tmp_path)
    assert np.load(tmp_path / "hole" / "succeed_actions.npy").shape == (2, 9)
    assert np.load(tmp_path / "mine" / "succeed_actions.npy").shape == (2, 11)
    again = load_official(tmp_path, games=["hole"])
    assert sorted(again.end_step.tolist()) == sorted(both.of_game("hole").end_step.tolist())
