"""Attempts in a browser: each is counted once, none is lost, and keys and lists do what they say."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("playwright", reason="make test-browser has a browser")

from iphyre_jax.viewer.plays import read_plays
from tests.browser.play_page import refuse, tab, until

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

pytestmark = pytest.mark.slow
READY = "board.dataset.state === 'ready'"


def play(page: Page) -> None:
    """Play without removals to the end."""
    if page.get_attribute("#board", "data-state") == "over":
        page.click("#start")
        until(page, READY)
    page.click("#start")
    page.click("#finish")
    until(page, "board.dataset.state === 'over'")


def test_a_second_tab_learns_that_all_attempts_are_used(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        other = page.context.new_page()
        other.goto(page.url)
        other.wait_for_selector("html[data-ready=support]")
        for left in range(4, -1, -1):
            play(page)
            until(page, f"standing.textContent.startsWith('{left} of 5')")
        play(other)
        until(other, "standing.textContent.startsWith('0 of 5')")
        assert other.inner_text("#result") == "Not counted: all 5 attempts are used"
        assert other.is_disabled("#start")
        other.click("#again")
        until(other, "standing.textContent.startsWith('5 of 5')")
        assert len(read_plays(tmp_path / "attempts.jsonl")) == 5


def test_an_attempt_that_was_refused_is_sent_again(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        page.route("**/api/attempt", refuse)
        play(page)
        until(page, "!error.hidden")
        assert page.inner_text("#error") == "the simulator is busy"
        page.keyboard.press("Shift")  # as any key without a meaning
        assert page.is_visible("#error")
        play(page)
        until(page, "resend.textContent === 'Save these 2 attempts again'")
        page.unroute("**/api/attempt")
        page.click("#resend")
        until(page, "standing.textContent.startsWith('3 of 5')")
        assert page.is_hidden("#resend")
        assert page.inner_text("#result").startswith("Not solved")
        assert len(read_plays(tmp_path / "attempts.jsonl")) == 2


def test_the_next_attempt_waits_for_the_result(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        waiting: list[Route] = []
        page.route("**/api/attempt", lambda route: waiting.append(route))
        play(page)
        assert page.inner_text("#start") == "Try again"
        assert page.is_disabled("#start")
        until(page, "document.getElementById('start').disabled")
        waiting[0].continue_()
        until(page, "!document.getElementById('start').disabled")
        assert page.inner_text("#result").startswith("Not solved")


def test_a_refused_game_leaves_the_list_at_the_one_that_is_shown(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        page.route("**/api/game", refuse)
        page.select_option("#game", label="hole")
        until(page, "!error.hidden")
        assert page.evaluate("game.selectedOptions[0].textContent") == page.inner_text("#name") == "support"
        assert page.get_attribute("html", "data-ready") == "support"


def test_another_game_may_be_chosen_during_a_play(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        # Tapes that take their time to open.
        page.evaluate(
            """() => {
                const open = Response.prototype.arrayBuffer;
                Response.prototype.arrayBuffer = async function () {
                    await new Promise((go_on) => setTimeout(go_on, 300));
                    return open.call(this);
                };
            }"""
        )
        page.click("#start")
        page.hover("#board")
        until(page, "board.dataset.frame >= 10")
        page.evaluate("document.getElementById('next').click()")
        until(page, "board.dataset.state === 'empty'")
        page.mouse.move(300, 400)
        page.mouse.move(400, 500)
        until(page, READY)
        assert not page.inner_text("#result")
        assert not (tmp_path / "attempts.jsonl").exists()


def test_a_board_without_a_game_does_nothing(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        page.route("**/api/game", refuse)
        page.reload()
        until(page, "!error.hidden")
        page.hover("#board")
        page.click("#board")
        for mode in ("compare", "edit", "play"):
            page.click(f"[data-mode={mode}]")
        assert page.get_attribute("#board", "data-state") != "running"


def test_keys_play_a_game(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        page.set_viewport_size({"width": 1280, "height": 500})
        assert page.get_by_role("button", name="previous game").count() == 1
        assert page.locator("output:not([aria-live=off])").count() == 0
        page.focus("#agents summary")
        page.keyboard.press(" ")
        assert page.get_attribute("#board", "data-state") == "ready"
        page.evaluate("document.activeElement.blur()")
        page.evaluate("scrollTo(0, 0)")
        page.keyboard.press(" ")
        until(page, "board.dataset.frame >= 10")
        page.keyboard.press(" ")
        held: list[Route] = []
        page.route("**/api/record", lambda route: held.append(route))
        page.keyboard.press("1")
        page.keyboard.press("2")  # while the first one is computed
        end = time.monotonic() + 30
        while not held and time.monotonic() < end:
            page.wait_for_timeout(10)
        held[0].continue_()
        while len(held) < 2 and time.monotonic() < end:
            page.wait_for_timeout(10)
        held[1].continue_()
        until(page, "result.dataset.plan")
        first, second = json.loads(page.get_attribute("#result", "data-plan") or "")
        assert second == first + 1
        assert page.evaluate("scrollY") == 0
