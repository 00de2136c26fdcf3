"""The named sets: no play in both train and test, pairs that differ by one small move, made once."""

from pathlib import Path

import numpy as np
import pytest

from iphyre_jax.data import NAMED_SETS, Dataset, known_plays, named_set, repeated_plays, shared_plays, verify
from iphyre_jax.data.named import sets as named_module
from iphyre_jax.data.named.pairs import _goes_on, _PairSearch, moved_plans
from iphyre_jax.data.named.varied import level_of
from iphyre_jax.data.search import STALE

OPTIONS = {"scale": 10, "games": ["hole", "unseen_hole"]}


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Dataset]:
    folder = tmp_path_factory.mktemp("sets")
    return {name: named_set(name, **OPTIONS, folder=folder) for name in NAMED_SETS if name != "graded"}


@pytest.mark.slow
@pytest.mark.further
def test_labels_are_those_of_the_stored_steps(sets: dict[str, Dataset]) -> None:
    for name in ("test", "pairs", "variations"):
        assert verify(sets[name].select(np.arange(0, len(sets[name]), 7))) == []


def test_counts(sets: dict[str, Dataset]) -> None:
    kinds = {name: (int(one.success.sum()), int((~one.success).sum())) for name, one in sets.items()}
    assert kinds["official"] == (5, 5)
    assert kinds["test"] == kinds["pairs"] == (10, 10)
    assert kinds["basic-large"] == (200, 200)
    assert sum(kinds["variations"]) == 100 * 32
    assert {entry["game"] for entry in sets["variations"].manifest["scenes"]} == {"hole"}


@pytest.mark.parametrize("train", ["official", "basic-large", "variations"])
@pytest.mark.parametrize("test", ["test", "pairs"])
def test_no_play_is_in_both_train_and_test(sets: dict[str, Dataset], train: str, test: str) -> None:
    assert shared_plays(sets[train], sets[test]) == 0


def test_a_shared_play_is_found(sets: dict[str, Dataset]) -> None:
    """Also if a removal that comes after the end differs."""
    one = sets["official"].select(sets["official"].success)
    later = one.steps.copy()
    later[later >= one.end_step[:, None]] = 899
    other = Dataset(**{**vars(one), "steps": later})
    assert shared_plays(other, sets["official"]) == len(one)
    assert sum(map(len, known_plays(one).values())) == len(one) - repeated_plays(one)


def test_new_sets_have_no_play_twice(sets: dict[str, Dataset]) -> None:
    for name in ("test", "pairs", "basic-large"):
        assert repeated_plays(sets[name]) == 0


def test_pairs_differ_by_one_small_move(sets: dict[str, Dataset]) -> None:
    pairs = sets["pairs"]
    tenths = np.rint(np.nan_to_num(pairs.times) * 10).astype(int)
    np.testing.assert_array_equal(pairs.success, np.tile([True, False], len(pairs) // 2))
    np.testing.assert_array_equal(pairs.game[::2], pairs.game[1::2])
    for one, other in zip(tenths[::2], tenths[1::2], strict=True):
        assert other.tolist() in [plan.tolist() for plan in moved_plans(one)]


def test_moved_plans() -> None:
    found = {tuple(plan.tolist()) for plan in moved_plans(np.array([1, 2, 0, 69]))}
    moved = {(1, 3, 0, 69), (1, 2, 0, 68)}  # 0 is never, 2 and 1 are taken, 70 is too late
    assert found == moved | {(2, 1, 0, 69), (69, 2, 0, 1), (1, 69, 0, 2)}


def test_a_set_is_made_once_and_a_changed_file_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = named_set("official", scale=50, games=["hole"], folder=tmp_path)
    monkeypatch.setattr(named_module, "gather", None)  # nothing is played again
    again = named_set("official", scale=50, games=["hole"], folder=tmp_path)
    np.testing.assert_array_equal(made.steps, again.steps)
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    with pytest.raises(ValueError, match=r"official-60fps-v1-.*npz: expected the bytes of its manifest"):
        named_set("official", scale=50, games=["hole"], folder=tmp_path)


def test_the_order_of_games_makes_no_other_set(tmp_path: Path) -> None:
    for games in (["support", "hole"], ["hole", "support"]):
        named_set("official", games=games, scale=25, folder=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 1


def test_a_game_without_pairs_ends() -> None:
    """Whoever removes both blocks of support within 7 s solves it; each plan is played once."""
    search = _PairSearch(set())
    stream = iter([[0.1, 0.2]] * (2 * STALE))
    first, numbers = search.next_plans(stream, 256)
    assert (first.tolist(), numbers.tolist()) == ([[1, 2]], [0])
    rounds = 0
    while _goes_on(search, 1, 10**6):
        assert len(search.next_plans(stream, 256)[0]) == 0
        rounds += 1
    assert rounds == STALE // 256
    assert search.draws == STALE + 256


def test_levels() -> None:
    assert [level_of(solved, 100) for solved in (0, 1, 2, 9, 10, 39, 69, 70, 100)] == [0, 0, 1, 2, 3, 4, 5, 6, 6]


WRONG = {
    "name": ({"name": "large"}, "name: expected one of official, test"),
    "games": ({"games": ["nothing"]}, "games: expected one of support"),
    "word": ({"games": "hole"}, "games: expected a sequence of names"),
    "none": ({"games": ["noisy_hole"], "name": "basic-large"}, "games: expected a game of the set"),
    "scale": ({"scale": 0}, "scale: expected a whole number"),
    "folder": ({"folder": 3}, "folder: expected the path of a folder"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_one_line(tmp_path: Path, case: str) -> None:
    options, message = WRONG[case]
    with pytest.raises(ValueError, match=message) as caught:
        named_set(**{"name": "official", "folder": tmp_path, **options})
    assert "\n" not in str(caught.value)


def test_the_cache_folder_may_be_turned_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IPHYRE_JAX_CACHE", "off")
    with pytest.raises(ValueError, match="folder: expected the path of a folder, because the cache folder is turned"):
        named_set("official")
