"""Frames, films and sheets: their contents, and the format of the files."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from iphyre_jax import GAMES, load_scene, memory
from iphyre_jax.compat.picture import picture
from iphyre_jax.compat.world import SteppedWorld
from iphyre_jax.viewer import films
from iphyre_jax.viewer.films import save, save_picture
from iphyre_jax.viewer.frames import Camera, Look, frames, still
from iphyre_jax.viewer.painter import font
from iphyre_jax.viewer.recording import Recording, record
from iphyre_jax.viewer.sheets import contact_sheet, start_of
from iphyre_jax.viewer.themes import THEMES

BARE = Look(captions=False, mark=False)


@pytest.fixture(scope="module")
def solved() -> Recording:
    return record(load_scene("hole"), [-1, -1, 83, 32])


@pytest.mark.slow
@pytest.mark.parametrize("game", ["hole", "spring", "impulse_pendulum"])
def test_the_official_theme_is_the_official_picture(game: str) -> None:
    """Compare with `iphyre_jax.observations.drawing`, as checked against the official class: edges may differ."""
    scene = load_scene(game)
    theirs = picture(SteppedWorld(scene, fps=60, resets=1)).astype(int)
    ours = still(start_of(scene), Look(theme="official", captions=False)).astype(int)
    assert ours.shape == theirs.shape
    apart = np.abs(ours - theirs).max(axis=2)
    assert apart.mean() < 1.0  # of 255
    assert (apart > 128).mean() < 0.002  # a line's zigzag is some pixels off


def test_a_removed_block_fades(solved: Recording) -> None:
    camera = Camera(solved, BARE)
    here = (400, 250)  # the middle of block 4
    block = solved.scene.blocks[4].mean(axis=0).round().astype(int)
    here = (int(block[1]), int(block[0]))
    shades = [np.asarray(camera.image(k))[here].astype(int) for k in (83, 84, 90, 100, 110)]
    ground = np.array(THEMES["modern"].background)
    distances = [np.abs(shade - ground).sum() for shade in shades]
    assert np.array_equal(shades[0], THEMES["modern"].eliminable)
    assert distances == sorted(distances, reverse=True)
    assert distances[0] > distances[2] > distances[4] == 0


def test_trails_and_marks_are_seen(solved: Recording) -> None:
    plain, trail = still(solved, BARE), still(solved, Look(captions=False, mark=False, trails=True))
    way = np.argwhere((plain != trail).any(axis=2))
    assert way[:, 0].min() < 200  # from where the ball came
    assert way[:, 0].max() > 560
    marked = still(solved, Look(captions=False))
    changed = np.argwhere((plain != marked).any(axis=2))
    assert changed[:, 0].max() < 80
    assert changed[:, 1].min() > 500
    failed = still(record(solved.scene, [-1, -1, -1, -1]), Look(captions=False))
    green, brown = THEMES["modern"].solved, THEMES["modern"].failed
    assert (marked == green).all(axis=2).any()
    assert (failed == brown).all(axis=2).any()


def test_captions_have_letters_of_many_scripts() -> None:
    """Pillow's own font shows each of these as the same empty box."""
    boxes = {font(20).getmask(letter).getbbox() for letter in "ë日"}
    shapes = [bytes(font(20, ascii_only=False).getmask(letter)) for letter in "ëПα✓\uffff"]
    assert len(boxes) == 1
    assert len(set(shapes)) == len(shapes)


def test_a_small_ball_is_seen_behind_its_joint() -> None:
    scene = load_scene("impulse_pendulum")
    small = replace(scene, balls=scene.balls * [1, 1, 0.25])
    ((x, y, radius),) = small.balls
    assert any(small.n_blocks in pair for pair in small.joints)
    assert radius == 5
    for theme, seen in (("modern", True), ("official", False)):
        picture = still(start_of(small), replace(BARE, size=600, theme=theme)).astype(int)
        dotted = np.abs(picture[round(y - 3), round(x)] - THEMES[theme].joint).max() < 30
        assert dotted != seen


def test_side_by_side_waits_for_the_longer(solved: Recording) -> None:
    longer = record(solved.scene, [-1, -1, -1, 32])
    taken = list(frames([solved, longer], Look(size=100), every=60, hold=0))
    assert len(taken) == 16  # 900 steps
    assert {one.shape for one in taken} == {(118, 208, 3)}
    np.testing.assert_array_equal(taken[6][:, :100], taken[-1][:, :100])
    assert (taken[6][:, 108:] != taken[-1][:, 108:]).any()


def test_films_keep_size_and_time(solved: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")  # its reader forks, which JAX warns of
    import imageio_ffmpeg

    film = tmp_path / "play.mp4"
    save(film, solved, Look(size=128), hold=0)
    meta = next(imageio_ffmpeg.read_frames(str(film)))
    assert meta["size"] == (128, 128 + Look(size=128).caption_height)
    assert meta["fps"] == 60
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(film))
    assert count == solved.steps + 1
    film = tmp_path / "play.gif"
    save(film, solved, Look(size=100), hold=1)
    with Image.open(film) as gif:
        assert gif.size == (100, 118)
        lasts = 0
        for k in range(gif.n_frames):
            gif.seek(k)
            lasts += gif.info["duration"]
    assert lasts == pytest.approx(1000 * (solved.steps / 60 + 1), abs=100)
    assert not list(tmp_path.glob(".*"))


def test_a_gif_is_written_frame_by_frame(solved: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[weakref.ref[np.ndarray]] = []
    alive: list[int] = []

    def watched(*arguments: Any, **options: Any) -> Iterator[np.ndarray]:
        for one in frames(*arguments, **options):
            made.append(weakref.ref(one))
            alive.append(sum(reference() is not None for reference in made))
            yield one

    monkeypatch.setattr(films, "frames", watched)
    save(tmp_path / "a.gif", solved, Look(size=64), hold=0)
    assert len(made) == 88
    assert max(alive) <= 3
    monkeypatch.setattr(memory, "available", lambda: 10**6)
    monkeypatch.setattr(memory, "_ALWAYS", 0)
    with pytest.raises(ValueError, match=r"size: expected a call of at most .* make a smaller film, or .mp4"):
        save(tmp_path / "b.gif", solved, Look(size=200), hold=0)
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]


def test_a_picture_is_the_frame(solved: Recording, tmp_path: Path) -> None:
    save(tmp_path / "a.png", solved, BARE, frame=40)
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), still(solved, BARE, frame=40))


def test_a_sheet_has_every_game(tmp_path: Path) -> None:
    sheet = contact_sheet([start_of(load_scene(game)) for game in GAMES], frame=0, look=Look(size=64))
    height = 64 + Look(size=64).caption_height
    assert sheet.shape == (6 + 5 * (height + 6), 6 + 8 * 70, 3)
    save_picture(tmp_path / "sheet.png", sheet)
    ball = np.array(THEMES["modern"].ball)
    for k in range(40):
        top, left = 6 + k // 8 * (height + 6), 6 + k % 8 * 70
        tile = sheet[top : top + height, left : left + 64]
        assert (np.abs(tile.astype(int) - ball).sum(axis=2) < 60).any(), GAMES[k]


def test_names_are_drawn_as_they_are(solved: Recording) -> None:
    Camera(solved, Look(size=128), "<b>\n\x00name\N{SNOWMAN}" * 50).image(0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"theme": "nice"}, "theme: expected one of"),
        ({"size": 10}, "size: expected"),
        ({"size": 1.5}, "size: expected"),
        ({"fade": -1}, "fade: expected"),
    ],
)
def test_a_wrong_look_gets_one_line(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Look(**change)  # type: ignore[arg-type]


def test_wrong_films_get_one_line(solved: Recording, tmp_path: Path) -> None:
    slow = Recording.of_poses(solved.scene, solved.plan, solved.poses, fps=10)
    for path, plays, look, message in (
        ("a.avi", solved, None, "path: expected a file name that ends in"),
        ("no/a.png", solved, None, "path: expected a file in a folder that exists"),
        ("a.gif", [], None, "plays: expected at least one"),
        ("a.png", 3, None, "plays: expected one or more recordings, got 3"),
        ("a.png", [3], None, "plays: expected recordings, got 3"),
        ("a.gif", [solved, slow], None, "all at one frame rate"),
        ("a.mp4", solved, Look(size=101, captions=False), "expected even numbers of px"),
    ):
        with pytest.raises(ValueError, match=message):
            save(tmp_path / path, plays, look)
    for titles in (3, [3]):
        with pytest.raises(ValueError, match=r"^titles: expected a text for each play, got "):
            save(tmp_path / "a.png", solved, titles=titles)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_pictures_of_jax_are_the_same_type(solved: Recording) -> None:
    assert still(solved, BARE).dtype == jnp.uint8
