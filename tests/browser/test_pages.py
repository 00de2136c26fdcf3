"""The pages in a real browser. `make test-browser` runs these tests; screenshots go to build/browser/."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("playwright", reason="make test-browser has a browser")

from iphyre_jax import GAMES, SceneBuilder, evaluate, load_scene, make, register, simulate
from iphyre_jax.scenes import read_scene
from iphyre_jax.viewer.films import save
from iphyre_jax.viewer.frames import Look
from iphyre_jax.viewer.load_plays import best_plays
from iphyre_jax.viewer.page import replay_page, write_replay
from iphyre_jax.viewer.plays import read_plays
from iphyre_jax.viewer.recording import Recording, record
from tests.browser.play_page import clicker, drag, opened, serving, shown_frame, until

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow
ARTEFACTS = Path(__file__).parents[2] / "build" / "browser"
HOSTILE = (
    "<script>alert(1)</script>",
    "</script><script>alert(2)</script>",
    "<img src=x onerror=alert(3)>",
    "<svg/onload=alert(4)>",
    "\"><b onmouseover='alert(5)'>",
    "' onfocus=alert(6) autofocus='",
    "javascript:alert(7)",
    "{{constructor.constructor('alert(8)')()}}",
    "${alert(9)}",
    "<!-- --!><script>alert(10)</script>",
    "<iframe srcdoc='<script>parent.alert(11)</script>'>",
    "<a href='javascript:alert(12)'>x</a>",
    "<style>*{display:none}</style>",
    "</title><script>alert(14)</script>",
    "</option></select><script>alert(15)</script>",
    "\\u003cscript\\u003ealert(16)\\u003c/script\\u003e",
    "&lt;script&gt;alert(17)&lt;/script&gt;",
    "<base href='http://evil.example/'>",
    "<meta http-equiv=refresh content='0;url=http://evil.example/'>",
    "__proto__",
)


@pytest.fixture(scope="module")
def recordings() -> dict[str, Recording]:
    return {game: play.record() for game, play in best_plays().items()}


def test_recordings_of_all_games_are_what_simulate_plays(recordings: dict[str, Recording]) -> None:
    assert tuple(recordings) == GAMES
    for game, recording in recordings.items():
        assert not best_plays()[game].difference(recording)
        played = simulate(game, [recording.plan], fps=60, dtype="float64")
        assert (played.success[0], played.reward[0]) == (True, recording.reward)


def test_the_replay_page_plays_scrubs_and_asks_for_nothing(
    page: Page, recordings: dict[str, Recording], tmp_path: Path
) -> None:
    file = tmp_path / "replay.html"
    plays = [*best_plays().values()]
    assert write_replay(file, plays) == []
    assert file.stat().st_size < 5_000_000
    begin = time.monotonic()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    opened = time.monotonic() - begin
    print(f"replay page of {len(plays)} games: {file.stat().st_size / 1000:.0f} kB, open after {opened:.2f} s")
    assert opened < 2.0

    page.keyboard.press(" ")
    until(page, "document.querySelector('canvas').dataset.frame > 30")
    page.keyboard.press(" ")
    here = shown_frame(page, "canvas")
    page.keyboard.press("ArrowRight")
    assert shown_frame(page, "canvas") == here + 1
    page.keyboard.press("Shift+ArrowLeft")
    assert shown_frame(page, "canvas") == here - 9
    page.locator(".scrub").fill("77")
    assert shown_frame(page, "canvas") == 77
    page.keyboard.press("End")
    assert "solved · 977.70" in page.inner_text("figcaption")
    page.keyboard.press("l")
    page.keyboard.press(" ")
    until(page, "document.querySelector('canvas').dataset.frame < 60")
    page.keyboard.press(" ")
    page.keyboard.press("c")
    page.keyboard.press("v")
    for keys in ("Meta+n", "Alt+p"):  # the browser's own
        page.keyboard.press(keys)
    for number, game in enumerate(GAMES):
        until(page, f"document.documentElement.dataset.ready === '{number}'")
        page.locator(".scrub").fill(str(recordings[game].steps // 2))
        assert shown_frame(page, "canvas") == recordings[game].steps // 2
        if game in ("fill", "multi_ball_stack"):
            page.screenshot(path=ARTEFACTS / f"replay-{game}.png")
        page.keyboard.press("n")
    until(page, "document.documentElement.dataset.ready === '0'")
    page.focus("#next")
    page.keyboard.press(" ")  # presses the button
    until(page, "document.documentElement.dataset.ready === '1'")
    page.click("#look")
    page.screenshot(path=ARTEFACTS / "replay-dark.png")
    assert page.asked == [file.as_uri()]  # type: ignore[attr-defined]


def test_two_plays_of_one_agent_differ_in_words(page: Page, recordings: dict[str, Recording], tmp_path: Path) -> None:
    file = tmp_path / "replay.html"
    plays = [("me", recordings["hole"]), ("you", recordings["hole"]), ("me", recordings["hole"])]
    file.write_text(replay_page(plays), "utf-8")
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    labels = page.locator("#left option").all_inner_texts()
    reward = f"{recordings['hole'].reward:.2f}"
    assert labels == [f"{name} · {reward} · 60 steps/s" for name in ("me #1", "you", "me #2")]
    page.select_option("#right", label=labels[2])
    page.wait_for_selector("figure:nth-child(2) canvas[data-frame]")
    until(page, "document.querySelectorAll('figcaption strong')[1].textContent === 'me #2'")
    captions = page.evaluate("[...document.querySelectorAll('figcaption')].map((one) => one.textContent)")
    assert captions == ["me #160 steps/s", "me #260 steps/s"]


def test_tapes_arrive_as_they_were_recorded(page: Page, recordings: dict[str, Recording], tmp_path: Path) -> None:
    recording = recordings["fill"]
    file = tmp_path / "replay.html"
    file.write_text(replay_page([("best", recording)]), "utf-8")
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    read = page.evaluate(
        """async () => {
            const data = JSON.parse(document.getElementById("data").textContent);
            const tape = await openTape(data.plays[0], data.scenes[0]);
            const frames = Array.from({ length: tape.frames }, (_, k) => k);
            return {
                poses: frames.map((k) => tape.pose(k)),
                contacts: frames.map((k) => tape.contacts(k)),
                velocities: frames.map((k) => tape.velocity(k)),
                gone: frames.map((k) => tape.pose(0).map((_, i) => tape.goneFor(i, k) > 0)),
            };
        }"""
    )
    np.testing.assert_allclose(read["poses"], recording.poses, atol=1 / 64)
    for k, points in enumerate(read["contacts"]):
        there = recording.contacts[k][np.isfinite(recording.contacts[k][:, 0])]
        np.testing.assert_allclose(np.reshape(points, (-1, 2)), there, atol=1 / 4)
        for entry in read["velocities"][k]:
            theirs = recording.velocities[k, entry["object"]]
            np.testing.assert_allclose([entry["vx"], entry["vy"]], theirs, atol=1 / 4)
        assert read["gone"][k] == (recording.last_frames < k).tolist()


def test_hostile_names_are_text(page: Page, tmp_path: Path) -> None:
    plays = []
    for name in HOSTILE:
        builder = SceneBuilder(name)
        builder.block((100, 500), (500, 500), eliminable=True)
        builder.ball((300, 300))
        plays.append((name, record(builder.build(), [10])))
    file = tmp_path / "hostile.html"
    file.write_text(replay_page(plays, title=HOSTILE[1]), "utf-8")
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    assert page.title() == HOSTILE[1]
    assert page.locator("#game option").all_inner_texts() == list(HOSTILE)
    for number, name in enumerate(HOSTILE):
        page.select_option("#game", index=number)
        until(page, f"document.documentElement.dataset.ready === '{number}'")
        assert page.inner_text("figcaption strong") == name
    assert page.locator("script").count() == 2
    page.screenshot(path=ARTEFACTS / "hostile.png")
    assert page.asked == [file.as_uri()]  # type: ignore[attr-defined]


def test_a_game_is_played_by_clicks(page: Page, tmp_path: Path) -> None:
    scene = load_scene("hole")
    with opened(page, tmp_path) as server:
        page.select_option("#game", label="hole")
        page.wait_for_selector("html[data-ready=hole]", timeout=60_000)
        click = clicker(page, "#board")
        click(300, 50)  # a click anywhere starts the game
        for block, frame in ((5, 30), (4, 83)):
            until(page, f"board.dataset.state === 'running' && board.dataset.frame >= {frame}")
            click(*scene.blocks[block].mean(axis=0))
        until(page, "result.dataset.reward")
        plan = json.loads(page.get_attribute("#result", "data-plan") or "")
        reward = float(page.get_attribute("#result", "data-reward") or "nan")
        page.screenshot(path=ARTEFACTS / "play.png")
        played = simulate(scene, [plan], fps=60, dtype="float64")
        print(f"played by clicks: plan {plan}, reward {reward}, simulate {played.reward[0]}")
        assert plan[2] >= 83
        assert plan[3] >= 30
        assert plan[:2] == [-1, -1]
        assert reward == played.reward[0]
        assert played.success[0]
        assert f"Solved: {reward:.2f}" in page.inner_text("#result")
        assert "966.08" in page.inner_text("#scores")
        (line,) = read_plays(tmp_path / "attempts.jsonl")
        assert list(line.plan) == plan
        assert not line.difference(line.record())

        page.click("#compare-now")
        page.wait_for_selector("#deck figure:nth-child(2) canvas[data-frame]")
        assert page.locator("#deck strong").all_inner_texts() == ["attempt 1", "best plan known"]
        page.locator(".scrub").fill("120")
        page.screenshot(path=ARTEFACTS / "compare.png")
        assert all(address.startswith(server.address) for address in page.asked)  # type: ignore[attr-defined]


def test_a_game_waits_while_another_part_of_the_page_is_shown(page: Page, tmp_path: Path) -> None:
    with opened(page, tmp_path):
        page.click("[data-mode=compare]")
        page.wait_for_selector("#deck canvas[data-frame]")
        assert page.is_visible("#left")
        page.click("[data-mode=play]")
        page.select_option("#game", label="unseen_support")
        page.wait_for_selector("html[data-ready=unseen_support]", timeout=60_000)
        page.click("#start")
        until(page, "board.dataset.frame >= 20")
        page.keyboard.press("Control+1")  # the browser's own
        page.click("[data-mode=compare]")
        until(page, "document.getElementById('status').textContent === 'Nobody has played this scene yet'")
        assert not page.locator("#deck figure").count()  # those of the game before have gone
        assert page.is_hidden("#left")
        assert page.is_hidden("#deck")
        left = shown_frame(page, "#board")
        page.wait_for_timeout(500)
        assert shown_frame(page, "#board") == left
        page.click("[data-mode=play]")
        assert not page.inner_text("#status")
        until(page, f"board.dataset.frame > {left}")
        assert page.get_attribute("#board", "data-state") == "running"
        page.click("#finish")
        until(page, "result.dataset.reward")
        assert set(json.loads(page.get_attribute("#result", "data-plan") or "")) == {-1}


def test_play_is_smooth(page: Page, tmp_path: Path) -> None:
    """Measure the frame rate of the page during a game, and the delay after a click."""
    with opened(page, tmp_path):
        page.click("#start")
        frames = page.evaluate(
            """() => new Promise((done) => {
                const times = [];
                const tick = (now) => (times.push(now), times.length < 90 ? requestAnimationFrame(tick) : done(times));
                requestAnimationFrame(tick);
            })"""
        )
        waited = page.evaluate(
            """async () => {
                const bar = [[0, 0], [1, 1]];
                const scene = { block: [bar, bar], ball: [[0, 0, 1]], eli: [1, 1, 0], dynamic: [0, 0, 1] };
                const begin = performance.now();
                const headers = { "Content-Type": "application/json" };
                const body = JSON.stringify({ scene: "support", plan: [90, -1] });
                const play = await (await fetch("api/record", { method: "POST", headers, body })).json();
                await openTape(play, scene);
                return performance.now() - begin;
            }"""
        )
    rate = 1000 * (len(frames) - 1) / (frames[-1] - frames[0])
    print(f"play: {rate:.0f} frames a second, {waited:.0f} ms from a click to the frames that follow")
    assert rate > 20  # headless, without a graphics card, on a busy machine
    assert waited < 500


def test_a_scene_is_drawn_saved_loaded_and_run(page: Page, tmp_path: Path) -> None:
    with opened(page, tmp_path):
        page.click("[data-mode=edit]")
        page.click("#clear")
        until(page, "problems.children.length === 1")
        assert page.inner_text("#problems li") == "ball: expected at least one ball, got none"
        page.screenshot(path=ARTEFACTS / "editor-invalid.png")
        click = clicker(page, "#sketch")
        page.fill("#scene-name", HOSTILE[0])
        page.keyboard.press("Tab")
        page.click("[data-tool=bar]")
        click(300, 400)
        page.click("#eli")
        page.click("[data-tool=bar]")
        click(300, 500)
        page.click("#turn-right")
        page.click("#longer")
        page.click("[data-tool=ball]")
        click(300, 340)
        page.click("[data-tool=bar]")
        click(120, 200)
        page.click("#dynamic")
        page.click("[data-tool=ball]")
        click(120, 300)
        for tool in ("joint", "spring"):
            page.click(f"[data-tool={tool}]")
            click(120, 200)
            click(120, 300)
            for _ in range(2):  # the same object twice changes nothing
                click(120, 200)
        page.click("[data-tool=select]")
        drag(page, (300, 400), (320, 410))
        until(page, "verdict.textContent === 'The scene is valid'")
        page.click("#undo")
        page.click("#redo")
        page.click("#dynamic")  # the dragged bar is removable, so it cannot also move
        until(page, "problems.children.length === 1")
        page.screenshot(path=ARTEFACTS / "editor-message.png")
        page.click("#undo")
        until(page, "verdict.textContent === 'The scene is valid'")
        page.screenshot(path=ARTEFACTS / "editor.png")
        with page.expect_download() as download:
            page.click("#save")
        file = tmp_path / "mine.json"
        download.value.save_as(file)
        scene = read_scene(file)
        assert scene.name == HOSTILE[0]
        assert (scene.n_blocks, scene.n_balls) == (3, 2)
        np.testing.assert_array_equal(scene.blocks[0].mean(axis=0), [320, 410])
        assert scene.eliminable.tolist() == [True, False, False, False, False]
        assert scene.dynamic.tolist() == [False, False, True, True, True]
        assert scene.joints == ((2, 4),)
        assert scene.springs == ((2, 4),)
        assert pytest.approx(np.degrees(np.arctan2(*(scene.blocks[1, 1] - scene.blocks[1, 0])[::-1])), abs=0.01) == 5

        page.click("#clear")
        page.set_input_files("#load", file)
        until(page, "document.getElementById('scene-name').value.startsWith('<script>')")
        page.click("#run")
        until(page, "document.documentElement.dataset.ready.startsWith('<script>')", 120)
        assert page.inner_text("#name") == HOSTILE[0]
        page.click("#start")
        until(page, "board.dataset.frame >= 20")
        clicker(page, "#board")(*scene.blocks[0].mean(axis=0))
        until(page, "board.dataset.state === 'running' && board.dataset.frame >= 60")
        page.screenshot(path=ARTEFACTS / "own-scene.png")
        page.click("#finish")
        until(page, "result.dataset.reward")
        (line,) = read_plays(tmp_path / "attempts.jsonl")
        assert line.scene == scene
        assert not line.difference(line.record())
    # What is saved trains: it makes an environment, and agents are evaluated on it.
    register("drawn-v1", [read_scene(file)])
    env, params = make("in-advance/drawn-v1")
    assert params.n_games == 1
    scores = evaluate(lambda key, _: env.action_space().sample(key), [scene], strategy="in-advance", episodes=4)
    assert np.isfinite(scores.mean_reward)


def test_small_screens_and_touch(browser: Any, tmp_path: Path) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 800}, has_touch=True, is_mobile=True)
    with serving(tmp_path) as server:
        page = context.new_page()
        page.goto(server.address)
        page.wait_for_selector("html[data-ready=support]", timeout=60_000)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        page.tap("#start")
        until(page, "board.dataset.frame >= 5")
        box = page.locator("#board").bounding_box()
        assert box
        scale = box["width"] / 600
        for block in load_scene("support").blocks:
            until(page, "board.dataset.state === 'running'")
            x, y = block.mean(axis=0) * scale
            page.touchscreen.tap(box["x"] + x, box["y"] + y)
        until(page, "result.dataset.reward")
        assert "Solved" in page.inner_text("#result")
        page.screenshot(path=ARTEFACTS / "phone.png")
    context.close()


def test_a_film_of_15_seconds_is_made_in_time(tmp_path: Path) -> None:
    recording = record(load_scene("hole"), [-1, -1, -1, 32])
    assert recording.steps == 900
    begin, cpu = time.monotonic(), time.process_time()
    save(tmp_path / "film.mp4", recording, Look(trails=True), hold=0)
    took = time.monotonic() - begin
    print(f"film of 900 frames of 600 px: {took:.1f} s, of which {time.process_time() - cpu:.1f} s of Python")
    assert took < 20
