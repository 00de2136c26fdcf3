"""The page: what it shows, and that it is safe to open and complete in itself."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from iphyre_jax import load_scene
from parity.compare import compare_plans
from parity.divergences import DivergedPlan
from parity.plans import random_plans
from parity.play import GameResult, WorstPlan, as_simulation, play_reference
from parity.reports.charts import log_height, sparkline
from parity.reports.page import median_over_plans, page
from parity.reports.tables import sections
from parity.stages import Divergence
from parity.statistics import PlayStatistics, Statistics

SCENE = load_scene("hole")
PLANS = random_plans(SCENE, 5, 10, seed=2)


@pytest.fixture(scope="module")
def text() -> str:
    """A page of two types; float64 has a plan that diverges, whose detail must be escaped."""
    plays = play_reference(SCENE, PLANS, 10, 15.0, 1)
    perturbed = play_reference(SCENE, PLANS, 10, 15.0, 1, gravity=1 + 1e-6)
    same = compare_plans(plays, as_simulation(plays), SCENE.dynamic, 10)
    other = compare_plans(plays, as_simulation(perturbed), SCENE.dynamic, 10)
    sides = (np.linspace(0, 1, 20) + np.arange(10)[:, None] for _ in range(2))
    pair = PlayStatistics("hole", 10, 1, *(Statistics(*side) for side in sides))
    found = Divergence(17, "contact masses", "row (0, 0): ours 1.0, the reference's <2.0>")
    diverged = DivergedPlan("hole", 10, "float64", 3, (1, 2, -1, -1), 0.25, (True, 80), (True, 81), 0, found)
    worst = WorstPlan(3, *(play.samples.astype(np.float32) for play in (plays[3], perturbed[3])))
    results = [
        GameResult(SCENE, 10, "float64", PLANS, other, {1e-6: other}, worst, (diverged,), pair),
        GameResult(SCENE, 10, "float32", PLANS, same, {1e-6: other}),
    ]
    return page(sections(results), results, {"versions": {"pymunk": "<7>"}, "xla flags": "none"})


def test_the_page_loads_nothing_and_runs_nothing(text: str) -> None:
    assert "default-src 'none'" in text
    assert not re.search(r"<script|<link|<img|<iframe|src=|@import|url\(|\son\w+=", text)
    assert not re.findall(r"https?://", text)
    assert all(target.startswith("#") for target in re.findall(r'href="([^"]*)"', text))
    assert "prefers-color-scheme: dark" in text


def test_every_element_is_closed(text: str) -> None:
    class Parser(HTMLParser):
        open_: list[str] = []  # noqa: RUF012 - one parser is made

        def handle_starttag(self, tag: str, attrs: object) -> None:
            if tag not in ("meta", "br"):
                self.open_.append(tag)

        def handle_startendtag(self, tag: str, attrs: object) -> None:
            pass

        def handle_endtag(self, tag: str) -> None:
            assert self.open_.pop() == tag

    parser = Parser()
    parser.feed(text)
    parser.close()
    assert parser.open_ == []


def test_a_diverged_plan_is_shown_with_its_stage(text: str) -> None:
    assert "step 17, contact masses" in text
    assert "the reference&#x27;s &lt;2.0&gt;" in text
    assert "<2.0>" not in text
    assert text.count("&lt;7&gt;") == 1
    assert "nan" not in re.sub(r"<style>.*?</style>", "", text, flags=re.DOTALL).lower().split()


def test_the_longest_of_the_counted_plays_is_told(text: str) -> None:
    assert "sums over the first 2 s at most" in text


def test_what_was_not_played_in_float64_is_not_said_to_agree_there() -> None:
    plays = play_reference(SCENE, PLANS, 10, 15.0, 1)
    same = compare_plans(plays, as_simulation(plays), SCENE.dynamic, 10)
    results = [GameResult(SCENE, 10, "float32", PLANS, same, {})]
    assert "float64" not in page(sections(results), results, {}).split("How to repeat")[0].split("</style>")[1]


def test_each_part_is_there(text: str) -> None:
    parts = "Error over time", "Worst plays, 10 fps, float64", "side by side", "How to repeat", "g x (1 + 1e-6)"
    assert [words for words in parts if words not in text] == []
    assert text.count('class="chart"') == 1  # one game at one rate
    assert text.count('class="scene"') == 1


def test_errors_are_drawn_on_a_logarithmic_scale_with_zero_at_its_foot() -> None:
    heights = log_height(np.array([0.0, 1e-20, 1e-5, np.inf, np.nan]))
    np.testing.assert_allclose(heights, [0.0, 0.0, 0.5, 1.0, np.nan])
    assert sparkline([(np.array([1.0, np.nan, 2.0, 3.0]), "float64")], logarithmic=True).count("M") == 3


def test_the_median_is_over_what_is_in_play() -> None:
    errors = np.array([[1.0, np.nan, np.nan], [3.0, 5.0, np.nan], [2.0, 7.0, np.nan]], np.float32)
    np.testing.assert_array_equal(median_over_plans(errors), [2.0, 5.0, np.nan])
