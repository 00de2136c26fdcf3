"""Write the table of headline figures in README.md from the documents in docs/results.

    python tools/readme_figures.py

A test does the same and compares, so that the README cannot say anything else than the results.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
HEADING: Final = "| what | figure |\n|---|---|\n"  # the only table of the README
COLUMNS: Final = {"basic": 1, "all": 5}  # cells of a row of results.md, after its name and its seeds


def cells(page: str, row: str, section: str = "") -> list[str]:
    """The cells of the first row whose name fits, behind its name.

    Args:
        page: text of a document.
        row: regular expression of the whole name.
        section: text before which no row counts.

    Raises:
        ValueError: one line; there is no such row.
    """
    begin = page.index(section)
    found = re.search(rf"^\| {row} \|(.*)\|$", page[begin:], re.MULTILINE)
    if found is None:
        raise ValueError(f"docs/results: expected a row {row!r} after {section!r}, found none")
    return [cell.strip() for cell in found[1].split("|")]


def reward(page: str, row: str, split: str) -> str:
    """Mean greedy reward of an agent of results.md at 10 fps; the paper's agents have no seeds and no interval."""
    return cells(page, row, "### Greedy actions")[COLUMNS[split]].split()[0]


def ranked(carry_over: str) -> tuple[str, str, str]:
    """At 60 fps: first try and best of five of policies whose plans a classifier ranks, and people's best of five."""
    at_60 = carry_over[carry_over.index("### 60 steps a second, reset 1") :]
    first, (_, _, five, *_) = cells(at_60, "refined")[5], cells(at_60, "refined", "| best of |")
    return first.split()[0], five.split()[0], cells(at_60, "people")[2]


def figures(performance: str, parity: str, results: str, carry_over: str) -> Iterable[tuple[str, str]]:
    """The rows of the table from the texts of performance.md, parity.md, results.md and carry-over.md."""
    for dtype, of in (("float32", " pymunk's bare `Space.step`"), ("float64", "")):
        speed, ratio = cells(performance, f"this project, {dtype}", "## Engines")
        rate = f"{speed} million steps a second, {float(ratio):.1f} times{of}"
        yield f"speed, {dtype}", rate
    shares = [cells(parity, "float64", f"{fps} steps a second")[0] for fps in (60, 10)]
    if shares != ["100", "100"]:
        raise ValueError(f"docs/results/parity.md: expected 100 % equal bit for bit, got {shares}")
    yield "parity, float64", "all poses of 4,000 plays equal pymunk's bit for bit"
    same = cells(parity, "float32", "60 steps a second")[5]
    yield "parity, float32, 60 steps a second", f"the same success as pymunk in {same} % of 2,000 plays"
    told = "In 2400 random episodes, 20 of each game and strategy, no reward and no flag differed, and all"
    if told not in " ".join(parity.split()):
        raise ValueError("docs/results/parity.md: expected 2400 official episodes without a difference")
    yield "official environments", "same observations, rewards and flags in 2,400 episodes"
    ours, quick, paper = (
        r"PPO-I default, \w+, official, objects, varied, generated",
        r"PPO-I quick, \w+, official",
        "paper: PPO-I",
    )
    basic, everything = ([reward(results, row, split) for row in (ours, paper)] for split in ("basic", "all"))
    yield "PPO in advance (`make run`), the ten basic games", f"mean reward {basic[0]}; the paper has {basic[1]}"
    yield (
        "the same, all forty games, thirty of them never trained on",
        f"{everything[0]}; the paper has {everything[1]}",
    )
    first, five, people = ranked(carry_over)
    yield (
        "all forty, a classifier chooses among plans of a policy (`refined`), 60 steps a second",
        f"{first}, best of five {five}; people {people}",
    )
    seconds = cells(results, quick, "### Time")[2]
    few, many = (reward(results, quick, split) for split in ("basic", "all"))
    yield f"`--preset quick`, {seconds} s of training", f"{few} on the ten basic games, {many} on all forty"


def with_figures(readme: str, folder: Path) -> str:
    """The text of the README with the figures of the documents in a folder."""
    pages = [(folder / f"{name}.md").read_text("utf-8") for name in ("performance", "parity", "results", "carry-over")]
    before, after = readme.split(HEADING)
    rest = re.sub(r"\A(\|.*\n)+", "", after)
    return before + HEADING + "".join(f"| {what} | {figure} |\n" for what, figure in figures(*pages)) + rest


def main() -> int:
    """Write the table."""
    readme = ROOT / "README.md"
    readme.write_text(with_figures(readme.read_text("utf-8"), ROOT / "docs" / "results"), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
