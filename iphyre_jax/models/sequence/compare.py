"""Every row of docs/results/sequence.md, one after the other; goes on where it stopped."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.models.sequence import evaluation, report, runs, sets, storage
from iphyre_jax.models.sequence.settings import SequenceConfig, settings
from iphyre_jax.models.settings import wanted_rows
from iphyre_jax.models.storage import BEST, Comparison
from iphyre_jax.provenance import provenance_facts
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.train.reports.printing import say

_OURS: Final = settings("ours")
_LARGE: Final = dataclasses.replace(_OURS, data="large", updates=1000)
ROWS: Final = {
    config.name: config
    for config in (
        *(settings(preset) for preset in ("paper-as-coded", "paper", "clone-solved", "clone-all")),
        _OURS,
        _LARGE,
        *(settings(preset, "combined") for preset in ("paper-as-coded", "paper")),
        dataclasses.replace(_LARGE, strategy="combined", updates=500),
        *(settings(preset, "on-the-fly") for preset in ("paper-as-coded", "paper")),
        dataclasses.replace(_LARGE, strategy="on-the-fly", fps=OFFICIAL_FPS, updates=500),
    )
}
SHIPPED: Final = ("ours-in-advance-large",)


def make_row(root: Path, config: SequenceConfig, console: Console) -> dict[str, Any]:
    """Train and evaluate a row in its run folder, or what is left of that; its evaluation."""
    folder = root / config.name
    data, plays = sets.learned_episodes(config, root / "data", console)
    state = runs.train(folder, config, data, plays, console)
    with console.status(f"{config.name} plays"):
        found = runs.evaluate(folder, config, state)
    storage.FILES.save(folder / BEST, runs.shipped(config, state, found))
    return found


def published_row(where: Comparison, config: SequenceConfig, console: Console) -> dict[str, Any]:
    """The evaluation of a row that is published; if there is none yet, `make_row` and publish it."""
    return storage.RUNS.published_row(where, config, lambda: make_row(where.root, config, console))


def bounds(where: Comparison, config: SequenceConfig, console: Console) -> dict[str, Row]:
    """Rows that learn nothing, at the rate of a row; each is kept in a file beside the published runs."""
    protocol = config.protocol

    def nearest() -> evaluation.Result:
        return evaluation.nearest(sets.official_plays(config, where.root / "data", console), protocol)

    makers: dict[str, Callable[[], evaluation.Result]] = {
        "doing nothing": lambda: evaluation.doing_nothing(protocol),
        "random plans": lambda: evaluation.randomly(protocol),
        "nearest neighbour": nearest,
    }
    folder, settings = where.published / f"bounds-{config.fps}fps", {"fps": config.fps}
    with console.status(f"bounds at {config.fps} steps a second"):
        return {name: kept_row(folder, name.replace(" ", "-"), settings, make) for name, make in makers.items()}


def compare(
    where: Comparison,
    best: Mapping[int, Mapping[str, tuple[float, float]]],
    console: Console,
    only: Sequence[str] = (),
) -> None:
    """Train what is missing, row by row, and write the document after each.

    Args:
        where: folders.
        best: mean reward and share solved of the best known plans by rate and split, to stand beside the rows.
        console: for progress.
        only: names of rows; by default all.

    Raises:
        ValueError: one line; there is no such row, or a folder holds another run.
    """
    wanted = wanted_rows(ROWS, only)
    found: dict[str, dict[str, Any]] = {}
    facts = provenance_facts()
    below: dict[int, dict[str, Row]] = {}
    for name, config in ROWS.items():
        if name in wanted:
            found[name] = published_row(where, config, console)
        elif (known := storage.RUNS.read_published(where.published / name, config)) is not None:
            found[name] = known
        if name not in found:
            continue
        if config.fps not in below:
            below[config.fps] = bounds(where, config, console)
        if name in SHIPPED and where.weights is not None and (where.root / name / BEST).is_dir():
            storage.FILES.save(where.weights, storage.load_model(name, where.root / name / BEST))
        report.write(where.out, found, below, best, [row for row in ROWS if row not in found], facts)
    say(console, f"Written: {where.out}")
