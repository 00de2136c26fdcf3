"""Generated scenes: what is kept holds what it promises, a run goes on where it stopped, files come back."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax.cli.main import run
from iphyre_jax.data.generated import (
    GeneratedScenes,
    chunks,
    compositions,
    drawing,
    filtering,
    generate,
    generate_scenes,
    load_generated,
    pool,
    save_generated,
    workers,
)
from iphyre_jax.data.generated.distance import NEAREST
from iphyre_jax.data.generated.filtering import IDLE, KEPT, REASONS, UNSOLVED, grade_scenes, plan_stream
from iphyre_jax.envs.protocols import PROTOCOLS
from iphyre_jax.execution import configuration
from iphyre_jax.execution.own_process import EndedError
from iphyre_jax.rules import NEVER
from iphyre_jax.scenes import Scene, SceneBuilder, load_scene
from iphyre_jax.scenes.compile import compile_scene
from iphyre_jax.simulation import simulate_many

OFFICIAL = PROTOCOLS["official"]


@pytest.fixture(autouse=True, scope="module")
def one_topology() -> Iterator[None]:
    """Draw compositions with one ball only, and few, so that one program plays all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compositions, "MOVERS", ((("ball",), 1),))
        patch.setattr(compositions, "COMPOSED", 1.0)
        for module in (drawing, chunks, generate):
            patch.setattr(module, "CHUNK", 128)
        patch.setattr(configuration, "threads", lambda: 1)  # other processes know nothing of this
        yield


PROCESS = """
from iphyre_jax.data.generated import __main__, chunks, compositions, drawing
compositions.MOVERS, compositions.COMPOSED = ((("ball",), 1),), 1.0
drawing.CHUNK = chunks.CHUNK = 128
__main__.main()
"""
SHORT_ANSWER = """input(); print('{"bytes": 100}'); print('short')"""


@pytest.fixture(scope="module")
def small(one_topology: None) -> GeneratedScenes:
    return generate_scenes(20, 7)


def replayed(scenes: tuple[Scene, ...], steps: np.ndarray) -> np.ndarray:
    """Whether each of (N, K, 6) plans solves its scene, (N, K)."""
    plans = steps.reshape(-1, 6)
    which = np.repeat(np.arange(len(scenes)), steps.shape[1])
    return simulate_many(scenes, which, plans, fps=10, resets=2).success.reshape(steps.shape[:2])


@pytest.mark.slow
def test_kept_scenes_are_what_is_promised(small: GeneratedScenes) -> None:
    scenes = small.scenes
    assert len(scenes) == len(small) == 20 == len(set(scenes))
    assert not replayed(scenes, np.full((20, 1, 6), NEVER)).any()
    steps = np.stack([plan_stream(len(scene.eliminable_blocks)) for scene in scenes])
    solved = replayed(scenes, steps)
    own = np.arange(160) < small.columns["plans"][:, None]
    np.testing.assert_array_equal((solved & own).sum(axis=1), small.columns["solved"])
    assert small.solve_rate.min() > 0
    assert small.solve_rate.max() <= 0.6
    assert small.columns["distance"].min() >= NEAREST
    assert sum(small.manifest["refused"].values()) + 20 == small.manifest["drawn"]
    assert sum(small.manifest["grades"].values()) == 20


@pytest.mark.slow
def test_fewer_scenes_are_the_first_of_more(small: GeneratedScenes) -> None:
    assert generate_scenes(12, 7).scenes == small.scenes[:12]


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on(small: GeneratedScenes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(line: str) -> None:
        raise KeyboardInterrupt(line)

    with pytest.raises(KeyboardInterrupt, match=r"^\d+ of 20 kept, 128 drawn, \d+ kept a second$"):
        generate_scenes(20, 7, journal=tmp_path / "parts", report=stop)
    drawn: list[int] = []
    original = workers.make_chunk

    def noted(settings: pool.GeneratorSettings, chunk: int) -> chunks.Arrays:
        drawn.append(chunk)
        return original(settings, chunk)

    monkeypatch.setattr(workers, "make_chunk", noted)
    assert generate_scenes(20, 7, journal=tmp_path / "parts").scenes == small.scenes
    assert 0 not in drawn
    assert not (tmp_path / "parts").exists()


@pytest.mark.slow
@pytest.mark.further
def test_processes_give_the_same_scenes(small: GeneratedScenes, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that ends in the midst of an answer is replaced by this process."""
    monkeypatch.setattr(configuration, "threads", lambda: 2)
    here: list[int] = []
    original = workers.make_chunk
    monkeypatch.setattr(workers, "make_chunk", lambda *chunk: (here.append(chunk[1]), original(*chunk))[1])
    for program in (PROCESS, SHORT_ANSWER):
        monkeypatch.setattr(workers, "COMMAND", ("-c", program))
        assert generate_scenes(25, 7).scenes[:20] == small.scenes
    assert here[:2] == [0, 0]
    assert {1, 2} <= set(here[2:])


@pytest.mark.parametrize("program", ["", "print('something else')", SHORT_ANSWER])
def test_an_answer_that_is_none_is_an_error(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "COMMAND", ("-c", program))
    process = workers.ChunkProcess(pool.GeneratorSettings(7, OFFICIAL, "elements"))
    with pytest.raises(EndedError):
        process.chunk(1)
    process.end()
    process.end()


def test_a_process_whose_reader_was_killed_ends_without_a_word() -> None:
    program = "from iphyre_jax.data.generated import __main__; __main__.make_chunk = lambda *_: {}; __main__.main()"
    ended, answers = os.pipe()
    os.close(ended)
    command = [sys.executable, "-P", "-c", program, "7", "official", "elements"]
    done = subprocess.run(
        command, input=b'{"chunk": 1}\n{"chunk": 2}\n', stdout=answers, stderr=subprocess.PIPE, timeout=120, check=True
    )
    os.close(answers)
    assert done.stderr == b""


def shelf(*bars: tuple[float, float]) -> Scene:
    """A ball over bars that can be removed, each a height and an x."""
    builder = SceneBuilder("shelf")
    for y, x in bars:
        builder.block((x - 50, y), (x + 50, y), eliminable=True)
    builder.ball((300, 200))
    return builder.build()


def test_reasons_of_scenes_by_hand() -> None:
    """Solves itself; needs either of two bars gone that any plan removes; held by a bar that stays."""
    builder = SceneBuilder("held")
    builder.block((250, 300), (350, 300))
    builder.ball((300, 200))
    scenes = [shelf((300, 100), (300, 500)), shelf((300, 300), (300, 500)), builder.build()]
    worlds = [compile_scene(scene, resets=2, dtype="float32") for scene in scenes]
    grades = grade_scenes(scenes, worlds, OFFICIAL, np.zeros(3))
    assert grades.reason.tolist() == [IDLE, filtering.EASY, UNSOLVED]
    assert grades.plans.tolist() == [0, 24, 160]
    removes = (plan_stream(2)[:24, 0] != NEVER).sum()
    assert grades.solved[1] == removes
    kept = grade_scenes(scenes, worlds, OFFICIAL, np.full(3, 0.5), idle_share=0.6)
    assert kept.reason.tolist() == [KEPT, filtering.EASY, UNSOLVED]
    assert kept.plans[0] == 24


def test_shares_decide() -> None:
    solved = np.array([0, 1, 20, 58, 57, 30, 30])
    reason, plans = np.full(7, UNSOLVED), np.full(7, 96)
    reason[5] = filtering.CONTACTS
    filtering._judge(reason, plans, solved, np.array([0.0, 0.99, 0.99, 0.0, 0.0, 0.0, 0.99]))
    names = [REASONS[k] for k in reason]
    assert names[0] == "no plan solves it"
    assert reason[1] == KEPT  # hard ones are all kept
    assert names[2] == names[6] == "of a frequent grade, not chosen"
    assert names[3] == "too easy"
    assert reason[4] == KEPT
    assert names[5] == "more contacts than a game has"


@pytest.mark.further
def test_unions_are_scenes_of_their_own_kind(tmp_path: Path) -> None:
    unions = generate_scenes(6, 7, kind="unions")
    assert (unions.columns["basic"] >= 0).all()
    assert unions.manifest["kind"] == "unions"
    assert all(scene.name.startswith("unions~7.") for scene in unions.scenes)
    save_generated(unions, tmp_path / "some.npz")
    assert load_generated(tmp_path / "some.npz").scenes == unions.scenes
    manifest = (tmp_path / "some.json").read_text()
    for wrong, shown in (('"pairs"', "'pairs'"), ("[]", "a list of 0")):
        (tmp_path / "some.json").write_text(manifest.replace('"unions"', wrong))
        with pytest.raises(ValueError, match=rf"some\.json: kind: expected one of elements, unions, got {shown}"):
            load_generated(tmp_path / "some.npz")


def test_only_what_solves_itself_is_above_the_last_grade() -> None:
    rates = np.array([0.01, 0.04, 0.6, 0.61])
    grades = {"below 0.04": 1, "0.04 to 0.15": 1, "0.15 to 0.35": 0, "0.35 to 0.6": 1, "above 0.6": 1}
    assert pool._grade_counts(rates) == grades
    assert "above 0.6" not in pool._grade_counts(rates[:3])


def test_files_come_back_and_changes_are_found(small: GeneratedScenes, tmp_path: Path) -> None:
    save_generated(small, tmp_path / "some.npz")
    again = load_generated(tmp_path / "some.json")
    assert again.scenes == small.scenes
    assert again.manifest == small.manifest
    content = bytearray((tmp_path / "some.npz").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "some.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"some\.npz: expected the bytes that some\.json tells of"):
        load_generated(tmp_path / "some.npz")


@pytest.mark.slow
def test_the_command_makes_and_describes_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = tmp_path / "some.npz"
    assert run(["generate", "--out", str(made), "--count", "15", "--seed", "7"]) == 0
    printed = capsys.readouterr().out
    assert "15 scenes of seed 7, 10 fps, float32, reset 2" in printed
    assert run(["generate", "--describe", str(made)]) == 0
    assert capsys.readouterr().out == printed
    assert sorted(path.name for path in tmp_path.iterdir()) == ["some.json", "some.npz"]


def test_the_shipped_scenes_are_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["generate", "--describe", "shipped"]) == 0
    assert "4000 scenes of seed 0, 10 fps, float32, reset 2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "out: expected the file to write, --out NAME.npz"),
        (["--out", "a.txt"], "out: expected the path of a data set"),
        (["--out", "a.npz", "--count", "0"], "count: expected a whole number of at least 1"),
        (["--out", "a.npz", "--seed", "-1"], "seed: expected a whole number of at least 0"),
        (["--describe", "missing.npz"], "missing.npz"),
        (["--describe", "missing.npz", "--count", "5"], "count: expected none with --describe, got 5"),
        (["--out", "a.npz", "--sheet", "a.gif"], "sheet: expected a file name that ends in .png"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["generate", *arguments]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1


def test_a_game_is_graded_as_it_is_played() -> None:
    games = [load_scene("hole"), load_scene("direction")]
    worlds = [compile_scene(game, resets=2, dtype="float32") for game in games]
    grades = grade_scenes(games, worlds, OFFICIAL, np.zeros(2))
    for game, plans, solved in zip(games, grades.plans, grades.solved, strict=True):
        steps = plan_stream(len(game.eliminable_blocks))[None, :plans]
        assert replayed((game,), steps).sum() == solved


def test_a_selection_is_saved_and_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shipped = load_generated("shipped")
    hard = shipped.select(shipped.solve_rate < 0.04)
    assert 0 < len(hard) < len(shipped)
    for some in (hard, hard.select([])):
        save_generated(some, tmp_path / "some.npz")
        again = load_generated(tmp_path / "some.npz")
        assert len(again) == len(some) == again.manifest["scenes"] == sum(again.manifest["grades"].values())
        assert again.scenes == some.scenes
        assert run(["generate", "--describe", str(tmp_path / "some.npz")]) == 0
        assert f"{len(some)} scenes of seed" in capsys.readouterr().out
    assert hard.manifest["nearest_px"] == hard.columns["distance"].min()
    with pytest.raises(ValueError, match=r"^rows: expected indices or a mask of 4000 rows, got 0$"):
        shipped.select(0)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("n_bars", -1, "n_bars: expected 0 to 11, got -1"),
        ("link", 99, "link: expected 0 to 2, got 99"),
        ("anchor", -1, "anchor: expected 0 to 10, got -1"),
        ("plans", 0, "plans: expected 1 to inf, got 0"),
        ("solved", 30_000, "solved: expected 0 to as many as plans, got 30000"),
        ("distance", np.nan, "distance: expected 0 to inf, got nan"),
    ],
)
def test_numbers_that_no_scenes_have_are_refused(
    column: str, value: float, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = load_generated("shipped").select([0, 1])
    wrong = some.columns[column].copy()
    wrong[1] = value
    bad = GeneratedScenes({**some.columns, column: wrong}, some.manifest)
    with pytest.raises(ValueError, match=f"^scenes: {message}$"):
        save_generated(bad, tmp_path / "bad.npz")
    with monkeypatch.context() as patch:
        patch.setattr(pool, "_check_columns", lambda *given: None)
        save_generated(bad, tmp_path / "bad.npz")
    with pytest.raises(ValueError, match=f"bad.npz: {message}$"):
        load_generated(tmp_path / "bad.npz")
