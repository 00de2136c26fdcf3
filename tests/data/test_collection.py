"""Collections: the counts and labels of the official generator, the same bits after a kill, no repeated play."""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import memory
from iphyre_jax.compat import generate_actions
from iphyre_jax.data import collect, collection, load_dataset, repeated_plays, save_dataset, shared_plays, verify
from iphyre_jax.data import labels as labels_module
from iphyre_jax.data.draws import neighbours
from iphyre_jax.data.generated import generate
from iphyre_jax.data.labels import Labels
from iphyre_jax.data.official_files import action_lists
from iphyre_jax.data.recipe import Recipe
from iphyre_jax.data.search import Search, play_keys
from iphyre_jax.plans import official_clock
from iphyre_jax.scenes import Limits, load_scene
from tests.data.worlds import small

OFFICIAL = {"hole": 148, "support": 122}  # draws until 50 of both kinds, of the official generator


def test_counts_of_the_official_generator() -> None:
    entries = collect(list(OFFICIAL)).manifest["scenes"]
    assert {entry["scene"]: entry["iterations"] for entry in entries} == OFFICIAL
    assert entries[1]["wait_successes"] == 81
    assert entries[1]["successes"] == entries[1]["failures"] == 50


def test_the_exact_form_equals_the_official_generator() -> None:
    exact = collect(["support"], successes=2, failures=2, form="exact")
    solved, failed, drawn = generate_actions("support", 2, 2, 0.1, 15.0, 7.0, 6)
    assert exact.manifest["scenes"][0]["iterations"] == drawn
    lists = action_lists(exact)
    np.testing.assert_array_equal(lists[exact.success], solved)
    np.testing.assert_array_equal(lists[~exact.success], failed)
    assert not verify(exact)


def test_labels_are_those_of_the_stored_steps() -> None:
    assert not verify(small())
    assert small().success.sum() == 12
    assert len(small()) == 24


@pytest.mark.slow
@pytest.mark.parametrize("name", ["success", "end_step", "removals", "steps", "poses"])
def test_a_wrong_label_is_found(name: str) -> None:
    whole = small()
    changed = {**whole.arrays(), name: getattr(whole, name).copy()}
    if name == "success":
        changed[name][3] ^= True
    elif name == "poses":
        changed[name][3, 70, 0, 1] += 1e-9
    else:
        changed[name][(3, slice(4)) if name == "steps" else 3] += 7
    other = type(whole)(whole.scenes, **changed, manifest=whole.manifest)
    assert any(line.startswith(name) and "(rows 3" in line for line in verify(other))


class Killed(BaseException):
    """Stands for SIGKILL: nothing catches it."""


def test_places_that_no_scene_needs_are_verified_as_empty() -> None:
    poses = small().poses
    assert poses is not None
    wider = np.concatenate([poses, np.full_like(poses, np.nan)], axis=2)
    assert verify(replace(small(), poses=wider)) == []
    wider[0, 0, -1] = 0.0
    assert verify(replace(small(), poses=wider)) == ["poses: 1 of 24 plays differ (rows 0)"]


@pytest.mark.slow
def test_a_killed_collection_goes_on_to_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"successes": 12, "failures": 12, "seed": 4, "sequences": True}
    save_dataset(collect(["hole"], **options), tmp_path / "whole.npz")
    monkeypatch.setattr(labels_module, "MOST_PLANS", 16)
    monkeypatch.setattr(labels_module, "MOST_SEQUENCES", 8)
    played, simulate_many, calls = 0, labels_module.simulate_many, 0

    def dying(*arguments: object, **others: object) -> object:
        nonlocal calls, played
        calls += 1
        if calls % 2 == 0:
            raise Killed
        played += 1
        return simulate_many(*arguments, **others)

    monkeypatch.setattr(labels_module, "simulate_many", dying)
    kills = 0
    while True:
        try:
            resumed = collect(["hole"], **options, journal=tmp_path / "journal")
            break
        except Killed:
            kills += 1
            damaged = min((tmp_path / "journal").glob("*.npz"))
            if kills == 1:
                damaged.write_bytes(damaged.read_bytes()[:-9])
    assert kills >= 2
    assert played == kills + 1
    save_dataset(resumed, tmp_path / "resumed.npz")
    assert (tmp_path / "resumed.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert not (tmp_path / "journal").exists()


def test_a_kill_while_saving_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The journal of a collection, and that of generated scenes, stay until the result is written."""

    def killed(_: object) -> None:
        raise Killed

    def one_chunk(*_: object) -> Iterator[dict[str, list[int]]]:
        yield {"number": [0]}

    monkeypatch.setattr(generate, "all_chunks", one_chunk)
    monkeypatch.setattr(generate.GeneratedScenes, "of_chunks", lambda *_: object())
    for work in (partial(collect, ["hole"], successes=1, failures=1), partial(generate.generate_scenes, 1)):
        journal = tmp_path / "journal"
        with pytest.raises(Killed):
            work(journal=journal, save=killed)
        assert journal.is_dir()
        saved: list[object] = []
        assert work(journal=journal, save=saved.append) is saved[0]
        assert not journal.exists()


@pytest.mark.slow
def test_mixed_has_neighbours_of_successes() -> None:
    mixed = collect(["hole"], successes=10, failures=10, distribution="mixed")
    assert (mixed.success.sum(), len(mixed)) == (10, 20)
    assert repeated_plays(mixed) == 0
    times = np.nan_to_num(mixed.times)
    first, later = times[:10], times[10:]
    bases = first[mixed.success[:10]]
    moved = np.abs(bases[:, None] - later[None])
    near = ((moved > 1e-3).sum(axis=2) == 1) & (moved.max(axis=2) < 0.51)
    assert near.any(axis=0)[mixed.success[10:]].all()  # failures are rare beside these successes
    assert near.any(axis=0)[~mixed.success[10:]].sum() >= 2


def test_neighbours_move_one_removal() -> None:
    plan = [0.1, 0.0, 6.9, 0.0, 0.0, 0.0]
    near = neighbours([plan, [0.0] * 6], seed=1)
    for other, _ in zip(near, range(200), strict=False):
        change = np.rint((np.array(other) - plan) * 10)
        assert np.count_nonzero(change) == 1
        assert 1 <= np.abs(change).max() <= 5
        assert np.array(other)[[0, 2]].min() > 0.05
        assert max(other) < 6.95
    assert list(neighbours([[0.0] * 6], seed=1)) == []


def test_plans_of_a_policy_until_the_draws_end() -> None:
    plan = [0.5, np.nan, 2.0, 1.0, np.nan, np.nan]
    made = collect(
        ["hole"], successes=3, failures=3, distribution="policy", policy=lambda *_: repeat(plan), max_draws=9
    )
    assert len(made) == 1  # the other eight are the same play
    assert made.manifest["scenes"][0]["iterations"] is None
    assert made.manifest["scenes"][0]["draws"] == 9
    np.testing.assert_array_equal(made.times[0], np.array(plan, np.float32))


def test_float32_plans_of_a_policy_have_the_labels_of_their_steps() -> None:
    plans = np.random.default_rng(0).choice(np.arange(1, 80) * 0.05, (40, 6)).astype(np.float32)
    plans[:, 4:] = 0
    made = collect(
        ["hole"],
        successes=40,
        failures=40,
        distribution="policy",
        policy=lambda *_: iter(plans),
        rule="in_advance",
        fps=10,
        max_draws=40,
    )
    assert len(made) > 30
    assert not verify(made)


def test_numbers_of_numpy_are_taken(tmp_path: Path) -> None:
    made = collect(["hole"], successes=1, failures=1, seed=np.int64(0), max_draws=np.int64(500), resets=np.int64(2))
    save_dataset(made, tmp_path / "made.npz")
    assert load_dataset(tmp_path / "made.npz").manifest["max_draws"] == 500


def test_the_same_plays_beside_a_larger_scene() -> None:
    alone, larger = collect(["hole"], successes=3, failures=3), load_scene("support", Limits(12, 7))
    beside = collect(["hole", larger], successes=3, failures=3)
    assert beside.steps.shape[1] == 7
    assert shared_plays(alone, beside) == shared_plays(beside, alone) == len(alone)
    assert repeated_plays(beside) == 0


@pytest.mark.parametrize("fps", [60, 200, 600])
def test_times_that_are_rounded_up_or_down_are_verified(fps: int) -> None:
    plans = [[1.234, 2.31, 0, 0, 0, 0], [3.36, 4.04, 0, 0, 0, 0], [1.0, 1.1, 0, 0, 0, 0]]
    made = collect(
        ["support"],
        failures=9,
        distribution="policy",
        policy=lambda *_: iter(plans),
        rule="in_advance",
        max_draws=3,
        fps=fps,
    )
    assert len(made) == 3
    assert not verify(made)


def test_plans_that_no_data_set_can_hold_are_one_line() -> None:
    with pytest.raises(ValueError, match=r"^policy: expected plans of 6 times, got one of shape \(2,\)$"):
        collect(["support"], distribution="policy", policy=lambda *_: repeat([1.0, 2.0]))
    for wrong, got in ((1e39, "1e+39"), (-1.0, "-1.0"), (np.inf, "inf"), (1e-300, "1e-300")):
        with pytest.raises(ValueError, match=rf"^policy: expected times from 0 on .*, got {re.escape(got)}$"):
            collect(["support"], distribution="policy", policy=lambda *_, first=wrong: repeat([first, 2.0, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match=r"^policy: expected plans of 6 times, got a list of 6$"):
        collect(["support"], distribution="policy", policy=lambda *_: repeat(["a", 2.0, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match=r"^policy: expected an iterator of plans, got None$"):
        collect(["support"], distribution="policy", policy=lambda *_: None)
    of_no_block = r"^policy: expected 0 or NaN after the times of the 2 eliminable blocks of support, got a list of 6"
    with pytest.raises(ValueError, match=of_no_block):
        collect(["support"], distribution="policy", policy=lambda *_: repeat([1.0, 2.0, 0.0, 0.0, 3.0, 0.0]))


@pytest.mark.parametrize("wanted", [0, pytest.param(60, marks=pytest.mark.further)])
def test_mixed_may_need_no_filling(wanted: int) -> None:
    assert len(collect(["support"], successes=wanted, failures=wanted, distribution="mixed")) == 2 * wanted


def test_uniform_plans_reach_to_fifteen_seconds() -> None:
    made = collect(["support"], successes=10, failures=10, distribution="uniform15")
    assert 7 < np.nanmax(made.times) < 15
    assert made.steps.max() < len(official_clock(60))


# Draws until 50 solve it at 10 fps as agents play: the rule in_advance, the second reset; measured with iphyre 0.2.3.
OFFICIAL_10 = {"hole": 148, "support": 81}


def test_counts_of_the_official_environment() -> None:
    options = {"fps": 10, "rule": "in_advance", "resets": 2}
    made = collect(list(OFFICIAL_10), failures=0, **options)
    assert {entry["scene"]: entry["iterations"] for entry in made.manifest["scenes"]} == OFFICIAL_10
    assert made.end_step.max() <= made.manifest["frames"] == 150
    assert not verify(made)


WRONG = {
    "rule": ({"rule": "late"}, "rule: expected one of simulate, in_advance"),
    "resets": ({"resets": 0}, "resets: expected a whole number"),
    "late": ({"rule": "in_advance", "fps": 25}, "fps: expected a multiple of 10 for the rule in_advance"),
    "games": ({"games": []}, "scenes: expected a sequence of at least one"),
    "successes": ({"successes": -1}, "successes: expected a whole number"),
    "distribution": ({"distribution": "gauss"}, "distribution: expected one of official"),
    "form": (
        {"form": "exact", "distribution": "mixed"},
        "form: expected fresh for the distribution mixed and resets 1",
    ),
    "fps": ({"fps": 5000}, "fps: expected at most 2183, with sequences a multiple of 10"),
    "rate": ({"fps": 25, "sequences": True}, "fps: expected at most 2183, with sequences a multiple of 10"),
    "seed": ({"seed": 2**32}, "seed: expected a whole number"),
    "policy": ({"distribution": "policy"}, "policy: expected a function"),
    "memory": ({"successes": 100_000, "sequences": True, "games": ["hole"] * 900}, "sequences: expected a call of at"),
    "journal": ({"journal": 3}, "journal: expected the path of a folder"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_one_line(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    options, message = WRONG[case]
    monkeypatch.setattr(memory, "available", lambda: 20 * 10**9)  # not what this machine has free just now
    with pytest.raises(ValueError, match=message) as caught:
        collect(**{"games": ["hole"], **options})
    assert "\n" not in str(caught.value)


def test_what_is_written_keeps_its_sums(tmp_path: Path) -> None:
    save_dataset(small(), tmp_path / "small.npz")
    assert not verify(load_dataset(tmp_path / "small.npz"))


def test_another_search_may_keep_what_a_last_round_drew_beyond_the_wanted() -> None:
    search = Search(iter(()), wanted=(1, 1), most=9, known={b"before"})
    steps, ends = np.arange(4)[:, None], np.full(4, 900, np.int16)
    search.add(steps, Labels(np.array([True, False, True, False]), ends, np.ones(4, np.int8), np.zeros(4, np.int8)))
    names = play_keys(steps, ends)
    assert search.surplus() == set(names[2:])
    assert search.known == {b"before", *names}
    scene, recipe = load_scene("support"), Recipe(distribution="mixed")
    search.times = [[0.1] * 6] * 4
    following = collection._filling_search(scene, [search], (2, 2), recipe)
    assert following.known == {b"before", *names[:2]}
    assert following.wanted == (1, 1)
