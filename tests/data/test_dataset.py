"""Data sets on disk: what is written is read, a changed byte is refused, equal sets have equal bytes."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax.data import Dataset, load_dataset, save_dataset, verify
from iphyre_jax.data import journal as journal_module
from iphyre_jax.data.dataset import SCHEMA, VERSION, _text, _with_sum, scene_entry
from iphyre_jax.data.journal import journal_in
from iphyre_jax.scenes import load_scene, vary

HOLE = load_scene("hole")
VARIED = vary(HOLE, 40, seed=3, shift_px=20).scenes[0]
NEVER = np.full((3, 6), np.nan, np.float32)


def made(**changes: Any) -> Dataset:
    """Three plays that were never played, of a game and a variation of it."""
    fields: dict[str, Any] = {
        "scenes": (HOLE, VARIED),
        "game": np.array([0, 1, 1], np.int32),
        "times": NEVER,
        "steps": np.full((3, 6), -1, np.int16),
        "success": np.array([True, False, True]),
        "end_step": np.array([200, 900, 899], np.int16),
        "removals": np.zeros(3, np.int8),
        "draw": np.arange(3, dtype=np.int32),
        "poses": None,
        "manifest": {
            "schema": SCHEMA,
            "version": VERSION,
            "distribution": "official",
            "form": "fresh",
            "fps": 60,
            "rule": "simulate",
            "frames": 900,
            "resets": 1,
            "dtype": "float64",
            "seed": 0,
            "scenes": [scene_entry(HOLE), scene_entry(VARIED)],
        },
    }
    return Dataset(**{**fields, **changes})


@pytest.mark.parametrize("poses", [None, np.linspace(0, 1, 3 * 150 * 3, dtype=np.float32).reshape(3, 150, 1, 3)])
def test_what_is_written_is_read(tmp_path: Path, poses: Any) -> None:
    one = made(poses=poses)
    save_dataset(one, tmp_path / "one.npz")
    read = load_dataset(tmp_path / "one.json")
    assert read.scenes == one.scenes
    assert read.arrays().keys() == one.arrays().keys()
    for name, array in one.arrays().items():
        assert getattr(read, name).dtype == array.dtype
        np.testing.assert_array_equal(getattr(read, name), array)
    assert read.manifest["fps"] == read.fps == 60
    assert len(read.of_game(VARIED.name)) == 2


def test_equal_data_sets_have_equal_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        save_dataset(made(), tmp_path / f"{name}.npz")
    save_dataset(load_dataset(tmp_path / "two.npz"), tmp_path / "two.npz")
    for suffix in (".npz", ".json"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_any_changed_byte_is_refused(tmp_path: Path, suffix: str) -> None:
    save_dataset(made(), tmp_path / "one.npz")
    file = tmp_path / f"one{suffix}"
    whole = file.read_bytes()
    changes = [whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :] for k in range(0, len(whole), 41)]
    for changed in (*changes, whole[:-1], whole + b" ", b""):
        file.write_bytes(changed)
        with pytest.raises(ValueError) as caught:
            load_dataset(file)
        assert "\n" not in str(caught.value)
        assert "one." in str(caught.value)


def test_a_changed_number_with_a_mended_sum_of_the_file_is_refused(tmp_path: Path) -> None:
    save_dataset(made(), tmp_path / "one.npz")
    manifest = json.loads((tmp_path / "one.json").read_text())
    manifest["seed"] = 10
    (tmp_path / "one.json").write_text(json.dumps(manifest, indent=1))
    with pytest.raises(ValueError, match=r"one\.json: expected the bytes that its sum tells of"):
        load_dataset(tmp_path / "one.npz")


HOSTILE = {
    "schema": ({"schema": "other"}, "schema: expected 'iphyre_jax/dataset'"),
    "version": ({"version": 2}, "version: expected 1, got 2"),
    "fps": ({"fps": "60"}, "fps: expected a positive whole number"),
    "form": ({"form": 3}, "form: expected fresh or exact"),
    "scenes": ({"scenes": [3]}, "scenes: expected a list of scenes"),
    "entry": ({"scenes": [{"scene": ["hole"], "sha256": ""}]}, "scenes: expected a list of scenes"),
    "arrays": ({"arrays": {"game": {"shape": [2**60]}}}, "arrays: expected a description of each array"),
    "unknown": ({"arrays": {"code": {"shape": [1]}}}, "arrays: expected a description of each array"),
    "huge": ({"arrays": {"poses": {"shape": [2**39, 150, 3]}}}, "path: expected a call of at most"),
    "npz": ({"npz": 3}, "npz: expected size and sum"),
    "size": ({"npz": {"bytes": 3, "sha256": ""}}, "one.npz: expected 3 bytes, got"),
    "other scene": (
        {"scenes": [scene_entry(HOLE), scene_entry(HOLE) | {"sha256": "0"}]},
        r"scenes\[1\]: sha256: expected 0",
    ),
    "missing": ({"frames": None}, "frames: expected this field"),
    "other frames": ({"frames": 3}, "frames: expected 900, got 3"),
    "no reset": ({"resets": 0}, "resets: expected the number of a reset from 1 on"),
    "resets": ({"resets": "x"}, "resets: expected the number of a reset from 1 on"),
    "other form": ({"form": "exact"}, "resets: expected draw [+] 2 for the form exact"),
    "rule": ({"rule": None}, "rule: expected simulate or in_advance, got None"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_wrong_manifest_with_a_right_sum_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    save_dataset(made(), tmp_path / "one.npz")
    changes, message = HOSTILE[case]
    manifest = {**json.loads((tmp_path / "one.json").read_text()), **changes}
    manifest = {key: value for key, value in manifest.items() if value is not None and key != "sha256"}
    (tmp_path / "one.json").write_bytes(_text(_with_sum(manifest)))
    with pytest.raises(ValueError, match=message) as caught:
        load_dataset(tmp_path / "one.npz")
    assert "\n" not in str(caught.value)


WRONG = {
    "path": (lambda path: load_dataset(path / "one.txt"), "path: expected the path of a data set"),
    "game": (
        lambda path: save_dataset(made(game=np.array([0, 1, 2], np.int32)), path / "a.npz"),
        "dataset: game: expected indices into 2 scenes",
    ),
    "dtype": (
        lambda path: save_dataset(made(steps=np.zeros((3, 6), np.int64)), path / "a.npz"),
        r"dataset: steps: expected int16 of shape \(3, any\), got int64",
    ),
    "length": (
        lambda path: save_dataset(made(draw=np.zeros(2, np.int32)), path / "a.npz"),
        r"dataset: draw: expected int32 of shape \(3\), got int32 of shape \(2,\)",
    ),
    "scenes": (
        lambda path: save_dataset(made(scenes=(HOLE,)), path / "a.npz"),
        "dataset: scenes: expected 2 as in the manifest",
    ),
    "columns": (
        lambda path: save_dataset(made(times=NEVER[:, :3], steps=np.full((3, 3), -1, np.int16)), path / "a.npz"),
        "dataset: times: expected 4 columns or more, got 3",
    ),
    "infinite": (
        lambda path: save_dataset(made(times=np.full((3, 6), np.inf, np.float32)), path / "a.npz"),
        "dataset: times: expected seconds from 0 on, or NaN for never, got inf",
    ),
    "negative": (
        lambda path: save_dataset(made(times=np.full((3, 6), -1, np.float32)), path / "a.npz"),
        "dataset: times: expected seconds from 0 on, or NaN for never, got -1.0",
    ),
    "end": (
        lambda path: save_dataset(made(end_step=np.array([1, 2, 901], np.int16)), path / "a.npz"),
        "dataset: end_step: expected 0 to 900 steps, got 901",
    ),
    "draw": (
        lambda path: save_dataset(made(draw=np.array([0, 1, -3], np.int32)), path / "a.npz"),
        "dataset: draw: expected numbers from 0 on, got -3",
    ),
    "movers": (
        lambda path: save_dataset(made(poses=np.zeros((3, 150, 0, 3))), path / "a.npz"),
        r"dataset: poses: expected shape \(N, 150, 1 or more, 3\), got \(3, 150, 0, 3\)",
    ),
    "pose frames": (
        lambda path: verify(made(poses=np.zeros((3, 10, 1, 3)))),
        r"dataset: poses: expected shape \(N, 150, 1 or more, 3\), got \(3, 10, 1, 3\)",
    ),
    "rows": (lambda path: made().select(0), "rows: expected indices or a mask of 3 rows, got 0"),
    "mask": (lambda path: made().select([True, False]), "rows: expected indices or a mask of 3 rows, got a list of 2"),
    "row": (lambda path: made().select([0, 3]), "rows: expected indices of 3 rows, got 0 to 3"),
    "text": (lambda path: made().select(["a"]), "rows: expected indices or a mask of 3 rows"),
    "name": (lambda path: made().of_game("seesaw"), "name: expected the name of a scene of the data set"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_one_line(tmp_path: Path, case: str) -> None:
    call, message = WRONG[case]
    with pytest.raises(ValueError, match=message) as caught:
        call(tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_selection_keeps_all_scenes() -> None:
    half = replace(made(), manifest={"fps": 60}).select(np.array([True, False, True]))
    assert len(half) == 2
    assert len(made().select([])) == 0
    assert half.scenes == (HOLE, VARIED)
    np.testing.assert_array_equal(half.draw, [0, 2])
    same_name = made(scenes=(HOLE, replace(VARIED, name="hole"), VARIED), game=np.array([0, 1, 2]))
    np.testing.assert_array_equal(same_name.of_game("hole").draw, [0, 1])


def test_arrays_of_another_kind_are_not_replaced(tmp_path: Path) -> None:
    for content in ({"weights": np.zeros(3)}, None):
        npz = tmp_path / "mine.npz"
        if content is None:
            npz.write_bytes(b"no archive")
        else:
            np.savez(npz, **content)  # type: ignore[arg-type]
        before = npz.read_bytes()
        with pytest.raises(ValueError, match=r"^path: .*mine\.npz is there and is no iphyre_jax/dataset; expected"):
            save_dataset(made(), npz)
        assert npz.read_bytes() == before
    save_dataset(made(), tmp_path / "killed.npz")
    (tmp_path / "killed.json").unlink()  # as a kill between the two files leaves it
    save_dataset(made(), tmp_path / "killed.npz")
    assert len(load_dataset(tmp_path / "killed.npz")) == 3


def test_a_journal_leaves_files_of_others(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "thesis.txt").write_text("precious")
    with journal_in(folder) as journal:
        journal.entry({"a": 1}, {}, lambda: {"x": np.zeros(2)})
        assert len(list(folder.glob("*.npz"))) == 1
        (folder / f".{'0' * 64}.01234567.part.npz").touch()  # the draft of a killed process
    assert [path.name for path in folder.iterdir()] == ["thesis.txt"]


def test_what_the_next_process_keeps_in_a_journal_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = journal_module.locked

    @contextmanager
    def then_another(folder: Path) -> Iterator[None]:
        with free(folder):
            yield
        (folder / f"{'1' * 64}.npz").touch()  # of the process that takes the lock now

    monkeypatch.setattr(journal_module, "locked", then_another)
    with journal_in(tmp_path) as journal:
        journal.entry({"a": 1}, {}, lambda: {"x": np.zeros(2)})
    assert [path.name for path in tmp_path.iterdir()] == [f"{'1' * 64}.npz"]
