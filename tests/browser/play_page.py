"""The play page in a browser: a server for it, waits, clicks and drags."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from iphyre_jax.viewer.play.api import Api
from iphyre_jax.viewer.play.server import PlayServer
from iphyre_jax.viewer.play.session import Session

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route


def until(page: Page, condition: str, seconds: float = 60.0) -> None:
    """Wait for a condition in JavaScript. The wait of Playwright needs eval, which the pages forbid."""
    end = time.monotonic() + seconds
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        time.sleep(0.004)


def shown_frame(page: Page, canvas: str) -> int:
    return int(page.locator(canvas).first.get_attribute("data-frame") or -1)


@contextmanager
def serving(folder: Path, **options: Any) -> Iterator[PlayServer]:
    with PlayServer(Api(Session(folder / "attempts.jsonl"), **options), "token") as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def opened(page: Page, folder: Path) -> Iterator[PlayServer]:
    """Open the play page and wait for its first game."""
    with serving(folder) as server:
        page.goto(server.address)
        page.wait_for_selector("html[data-ready=support]", timeout=60_000)
        yield server


def clicker(page: Page, canvas: str) -> Callable[[float, float], None]:
    """Return a function that clicks at a point of the scene."""
    box = page.locator(canvas).bounding_box()
    assert box
    scale = box["width"] / 600

    def click(x: float, y: float) -> None:
        page.mouse.click(box["x"] + x * scale, box["y"] + y * scale)

    return click


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    box = page.locator("#sketch").bounding_box()
    assert box
    scale = box["width"] / 600
    points = [(box["x"] + x * scale, box["y"] + y * scale) for x, y in (start, end)]
    page.mouse.move(*points[0])
    page.mouse.down()
    page.mouse.move(*points[1], steps=4)
    page.mouse.up()


@contextmanager
def tab(browser: Browser, folder: Path, **options: Any) -> Iterator[Page]:
    """Open the play page in a window of its own, in which requests may fail but no script may."""
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
    page, errors = context.new_page(), list[str]()
    page.on("pageerror", lambda error: errors.append(str(error)))
    with opened(page, folder), context:
        yield page
    assert not errors, errors


def refuse(route: Route) -> None:
    """Answer as a busy simulator does."""
    route.fulfill(status=503, content_type="application/json", body='{"error": "the simulator is busy"}')


def saved_scene(page: Page) -> tuple[str, Any]:
    """Press Save file; return the name and the contents of the file."""
    with page.expect_download() as download:
        page.click("#save")
    return download.value.suggested_filename, json.loads(download.value.path().read_text("utf-8"))
