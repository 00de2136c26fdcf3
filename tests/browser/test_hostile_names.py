"""Names of scenes and players that try to become markup or code stay text, on the replay page and the play page."""

from __future__ import annotations

from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("playwright", reason="make test-browser has a browser")

from iphyre_jax import SceneBuilder
from iphyre_jax.scenes import Scene
from iphyre_jax.viewer.page import replay_page
from iphyre_jax.viewer.play.api import Api
from iphyre_jax.viewer.play.server import PlayServer
from iphyre_jax.viewer.play.session import Session
from iphyre_jax.viewer.plays import Play
from iphyre_jax.viewer.recording import record
from tests.browser.play_page import until

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow
SCENES = (
    "</script><script>window.ran=1</script>",
    "<img src=x onerror=window.ran=2>",
    "\"' onfocus=window.ran=3 autofocus='",
    "<!-- --!><script>window.ran=4</script>",
)
AGENTS = (
    *SCENES,
    "line\u2028window.ran=5;\u2029break",
    "\u202e</script><script>window.ran=6</script>\u202c",
    "\u2066isolated\u202egpj.exe",
    "nul\0and\x1b[2Jterminal",
)


def scene(name: str) -> Scene:
    builder = SceneBuilder(name)
    builder.block((100, 500), (500, 500), eliminable=True)
    builder.ball((300, 300))
    return builder.build()


def check_that_nothing_ran(page: Page, scripts: int, asked: str) -> None:
    assert page.evaluate("window.ran === undefined")
    assert page.locator("script").count() == scripts
    assert page.locator("img, iframe, [onfocus], [onerror]").count() == 0
    assert all(address.startswith(asked) for address in page.asked)  # type: ignore[attr-defined]


def test_names_are_text_on_the_replay_page(page: Page, tmp_path: Path) -> None:
    plays = [(agent, record(scene(SCENES[number % len(SCENES)]), [10])) for number, agent in enumerate(AGENTS)]
    file = tmp_path / "hostile.html"
    file.write_text(replay_page(plays, title=AGENTS[5]), "utf-8")
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-ready]")
    assert page.evaluate("document.getElementById('title').textContent") == AGENTS[5]
    assert page.locator("#game option").all_inner_texts() == list(SCENES)
    for number in range(len(SCENES)):
        page.select_option("#game", index=number)
        until(page, f"document.documentElement.dataset.ready === '{number}'")
        shown = page.evaluate("[...document.querySelectorAll('figcaption strong')].map((name) => name.textContent)")
        assert shown == [agent for k, agent in enumerate(AGENTS) if k % len(SCENES) == number]
        # An override of the direction of writing ends with its name.
        style = "getComputedStyle(document.querySelector('figcaption strong')).unicodeBidi"
        assert page.evaluate(style) == "isolate"
    check_that_nothing_ran(page, 2, file.as_uri())


def test_names_are_text_on_the_play_page(page: Page, tmp_path: Path) -> None:
    scenes = [scene(name) for name in SCENES]
    agents = [Play(agent, one, (10,)) for one in scenes for agent in AGENTS]
    with PlayServer(Api(Session(tmp_path / "attempts.jsonl", SCENES[0]), agents, scenes), "token") as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1})
        thread.start()
        try:
            page.goto(server.address)
            page.wait_for_selector("html[data-ready=support]", timeout=90_000)
            scripts = page.locator("script").count()
            for name in SCENES:
                page.select_option("#game", label=name)
                until(page, f"document.documentElement.dataset.ready === {name!r}")
                assert page.evaluate("document.getElementById('name').textContent") == name
            page.click("[data-mode=compare]")
            page.wait_for_selector("#deck figure canvas[data-frame]")
            options = page.evaluate("[...document.querySelectorAll('#left option')].map((one) => one.textContent)")
            assert all(any(agent in option for option in options) for agent in AGENTS)
            page.click("[data-mode=edit]")
            until(page, f"document.getElementById('scene-name').value === {SCENES[-1]!r}")
            page.fill("#scene-name", AGENTS[5])
            page.keyboard.press("Tab")
            until(page, "problems.children.length === 1")
            assert "\u202e" not in page.evaluate("problems.textContent")  # such a name is refused, and shown escaped
            check_that_nothing_ran(page, scripts, server.address)
        finally:
            server.shutdown()
            thread.join()
