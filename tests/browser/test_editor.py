"""The scene editor in a browser: what is drawn is saved, on a phone too, and nothing is lost with the server."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("playwright", reason="make test-browser has a browser")

from iphyre_jax.scenes import read_scene
from tests.browser.play_page import clicker, drag, saved_scene, tab, until

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Dialog, Page, Route

pytestmark = pytest.mark.slow
VALID = "verdict.textContent === 'The scene is valid'"
PHONE = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}


def edit(page: Page) -> None:
    """Open the editor with the first game, support: blocks at (250, 400) and (250, 500)."""
    page.click("[data-mode=edit]")
    until(page, VALID)


def asked(page: Page) -> list[str]:
    """Stay on the page whenever it asks; return what it asks from now on."""
    said: list[str] = []

    def stay(dialog: Dialog) -> None:
        said.append(dialog.type)
        dialog.dismiss()

    page.on("dialog", stay)
    return said


def test_the_file_is_the_scene_that_is_drawn(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        edit(page)
        waiting: list[Route] = []
        page.route("**/api/check", lambda route: waiting.append(route))  # a server that takes its time
        x, y = _middle(page)
        drag(page, (x, y), (x + 50, y - 100))
        until(page, "verdict.textContent === 'Checking the scene …'")
        assert _middle(page) == [x + 50, y - 100]
        page.fill("#scene-name", "precious")  # Save takes the keyboard from the name, which changes the scene
        file, scene = saved_scene(page)
        assert (file, scene["name"]) == ("precious.json", "precious")
        for route in waiting:
            route.continue_()
        page.unroute("**/api/check")
        until(page, VALID)
        for name, expected in (("日本", "日本.json"), ("..", "scene.json"), ("con/aux", "con_aux.json")):
            page.fill("#scene-name", name)
            assert saved_scene(page)[0] == expected
        with page.expect_download() as download:
            page.click("#save")
        assert read_scene(download.value.path()).name == "con/aux"


def test_a_drawing_is_not_lost_with_the_server(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        said = asked(page)
        edit(page)
        page.route("**/api/check", lambda route: route.abort())
        x, y = _middle(page)
        drag(page, (x, y), (x, y - 100))
        until(page, "verdict.textContent === 'The scene could not be checked'")
        assert "the server does not answer" in page.inner_text("#problems")
        page.evaluate("location.reload()")
        page.wait_for_timeout(500)
        assert said == ["beforeunload"]
        assert _middle(page) == [x, y - 100]
        page.reload()
        page.wait_for_selector("html[data-ready=support]")
        assert said == ["beforeunload"]


def test_what_was_undone_comes_back_from_another_tab(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        edit(page)
        assert page.is_disabled("#undo")  # there is nothing before the scene that was opened
        x, y = _middle(page)
        drag(page, (x, y), (x, y - 100))
        page.click("#undo")
        assert page.is_disabled("#undo")
        page.click("[data-mode=play]")
        page.click("[data-mode=edit]")
        assert _middle(page) == [x, y]
        page.click("#redo")
        assert _middle(page) == [x, y - 100]


def test_a_drawing_that_another_scene_replaced_is_asked_for(browser: Browser, tmp_path: Path) -> None:
    """Undo would bring it back, and a new page would not."""
    with tab(browser, tmp_path) as page:
        said = asked(page)
        edit(page)
        x, y = _middle(page)
        drag(page, (x, y), (x, y - 100))
        until(page, VALID)
        page.click("#clear")
        page.evaluate("location.reload()")
        page.wait_for_timeout(500)
        assert said == ["beforeunload"]
        page.click("#undo")
        assert _middle(page) == [x, y - 100]
        saved_scene(page)
        page.reload()
        page.wait_for_selector("html[data-ready=support]")
        assert said == ["beforeunload"]


def test_messages_do_not_cover_each_other(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        edit(page)
        page.click("#clear")
        click = clicker(page, "#sketch")
        for x, y in ((300, 300), (310, 305), (320, 310)):
            page.click("[data-tool=bar]")
            click(x, y)
        page.click("[data-tool=ball]")
        click(300, 50)
        until(page, VALID)
        written = page.evaluate(
            """() => {
              const pen = document.getElementById("sketch").getContext("2d"), rows = [];
              const fill = pen.fillText;
              pen.fillText = function (text, x, y) {
                rows.push([x, y, this.measureText(text).width]);
                fill.call(this, text, x, y);
              };
              dispatchEvent(new Event("resize"));
              delete pen.fillText;
              return rows;
            }"""
        )
        assert len(written) >= 2
        for place, (x, y, width) in enumerate(written):
            for u, v, other in written[:place]:
                assert abs(y - v) >= 14 or x >= u + other or u >= x + width


def test_indices_do_not_outlive_a_change(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path) as page:
        edit(page)
        page.click("#clear")
        click = clicker(page, "#sketch")
        for y in (100, 200, 300):
            page.click("[data-tool=bar]")
            click(300, y)
        page.click("[data-tool=ball]")
        click(300, 50)
        page.click("[data-tool=joint]")
        click(300, 100)
        page.keyboard.press("Delete")
        click(300, 300)
        page.click("[data-tool=select]")
        until(page, VALID)
        scene = saved_scene(page)[1]
        assert [_centre(block)[1] for block in scene["block"]] == [200, 300]
        assert scene["joint"] == []
        click(300, 200)
        box = page.locator("#sketch").bounding_box()
        assert box
        scale = box["width"] / 600
        page.mouse.move(box["x"] + 300 * scale, box["y"] + 200 * scale)
        page.mouse.down()
        page.mouse.move(box["x"] + 320 * scale, box["y"] + 240 * scale, steps=3)
        page.keyboard.press("Delete")
        page.mouse.move(box["x"] + 330 * scale, box["y"] + 420 * scale, steps=3)
        page.mouse.up()
        until(page, VALID)
        assert [_centre(block) for block in saved_scene(page)[1]["block"]] == [[300, 300]]
        page.click("#undo")
        assert [_centre(block) for block in saved_scene(page)[1]["block"]] == [[320, 240], [300, 300]]
        page.click("#undo")
        assert [_centre(block) for block in saved_scene(page)[1]["block"]] == [[300, 200], [300, 300]]


def test_a_finger_drags_objects(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path, **PHONE) as page:
        edit(page)
        x, y = _middle(page)
        page.evaluate("scrollTo(0, 0)")
        box = page.locator("#sketch").bounding_box()
        assert box
        scale = box["width"] / 600
        screen = page.context.new_cdp_session(page)

        def touch(kind: str, *points: tuple[float, float]) -> None:
            places = [{"x": box["x"] + u * scale, "y": box["y"] + v * scale} for u, v in points]
            screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

        touch("touchStart", (x, y))
        for by in range(10, 201, 10):
            touch("touchMove", (x, y - by))
        touch("touchEnd")
        until(page, VALID)
        assert page.evaluate("scrollY") == 0
        assert _middle(page) == [x, y - 200]
        page.evaluate("scrollTo(0, 0)")
        touch("touchStart", (x, y - 200))
        for by in range(10, 51, 10):
            touch("touchMove", (x + by, y - 200))
        touch("touchCancel")
        assert _middle(page) == [x, y - 200]


def test_every_part_of_the_page_fits_a_phone(browser: Browser, tmp_path: Path) -> None:
    with tab(browser, tmp_path, **PHONE) as page:
        for mode in ("play", "compare", "edit"):
            page.click(f"[data-mode={mode}]")
            if mode == "compare":
                page.wait_for_selector("#deck canvas[data-frame]")
            page.screenshot(path=Path(__file__).parents[2] / "build" / "browser" / f"phone-{mode}.png", full_page=True)
            assert page.evaluate("document.documentElement.scrollWidth") <= 390, mode


def _middle(page: Page) -> list[float]:
    """Return the middle of the first block of the scene in the editor."""
    return _centre(saved_scene(page)[1]["block"][0])


def _centre(block: list[list[float]]) -> list[float]:
    return [(a + b) / 2 for a, b in zip(*block, strict=True)]
