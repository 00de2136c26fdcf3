"""Every run of docs/results/world.md, one after the other; goes on where it stopped."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from iphyre_jax.files import replace_json
from iphyre_jax.models.settings import row_of, wanted_rows
from iphyre_jax.models.storage import EVALUATION, VERSION, Comparison
from iphyre_jax.models.world import storage
from iphyre_jax.models.world.planning import PLANS, model_planner, planned, planning_bounds
from iphyre_jax.models.world.reports import report
from iphyre_jax.models.world.reports.metrics import COLUMNS, error_bounds, frequent_outcomes, measured
from iphyre_jax.models.world.runs import train
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.storage import WorldModel
from iphyre_jax.provenance import provenance, provenance_facts
from iphyre_jax.scenes import SPLITS
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.reports.printing import say

SEEDS: Final = (0, 1, 2)
SHIPPED: Final = "objects-unlimited"
CHOSEN_ON: Final = "unseen_basic"  # games with which the best seed is chosen
# The paper's batches are of 128 windows; 5,000 steps of 16 are within reach of two cores.
_MDRNN: Final = WorldConfig(model="mdrnn", data="1000", learning_rate=1e-3, steps=400, batch_size=128, chunk=20)
ROWS: Final = {
    config.row: config
    for config in (
        WorldConfig(data="unlimited"),
        WorldConfig(data="1000"),
        WorldConfig(data="100"),
        _MDRNN,
        dataclasses.replace(_MDRNN, steps=5000, batch_size=16, chunk=50),
    )
}


def row_settings(name: str, seed: int = 0) -> WorldConfig:
    """The settings of a row.

    Raises:
        ValueError: one line; there is no such row, or no such seed.
    """
    config = dataclasses.replace(row_of(ROWS, name), seed=seed)
    config.check()
    return config


def evaluate(folder: Path, plans: int, console: Console) -> dict[str, Any]:
    """Measure a run and write evaluation.json after each part; parts that are there are kept.

    Args:
        folder: of the run, which may be under way.
        plans: that are drawn for each game, to be imagined; 0 for no planning.
        console: for progress.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    model = storage.trained_model(folder)
    content = _evaluation(folder, model)
    for column in COLUMNS:
        if column not in content["columns"]:
            with console.status(f"{folder.name}: {column}"):
                content["columns"][column] = measured(model, column)
            replace_json(folder / EVALUATION, content)
    for split in PAPER_SPLITS if plans else ():
        if content["planning"].get(split, {}).get("plans") != plans:
            with console.status(f"{folder.name}: plans in {split}"):
                content["planning"][split] = planned(model_planner(model, plans), SPLITS[split], plans)
            replace_json(folder / EVALUATION, content)
    return content


def ship(folders: Sequence[Path], weights: Path) -> list[str]:
    """Write the best of evaluated runs of each row as trained models, and return their names.

    The best one imagines most outcomes of CHOSEN_ON rightly; the first one among equals.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it; a run is not whole.
    """
    best: dict[str, tuple[float, Path]] = {}
    for folder in folders:
        if not _is_whole(folder):
            raise ValueError(f"{folder / EVALUATION}: steps: expected those of a whole run")
        measures = storage.RUNS.read_evaluation(folder)["columns"].get(CHOSEN_ON)
        if measures is None:
            raise ValueError(f"{folder / EVALUATION}: columns: expected {CHOSEN_ON}, it is not there yet")
        right, name = measures["outcomes"]["right"], storage.RUNS.read_config(folder).row
        if name not in best or right > best[name][0]:
            best[name] = (right, folder)
    for name, (right, folder) in best.items():
        model = storage.trained_model(folder)
        chosen = {"seeds": len(folders), "chosen by": f"share of right outcomes in {CHOSEN_ON}", "share": right}
        storage.FILES.save(weights, dataclasses.replace(model, name=name, origin={**model.origin, **chosen}))
    return list(best)


def _is_whole(folder: Path) -> bool:
    """Whether a run was evaluated after its last step."""
    if not (folder / EVALUATION).is_file():
        return False
    return bool(storage.RUNS.read_evaluation(folder).get("steps") == storage.RUNS.read_config(folder).steps)


def _evaluation(folder: Path, model: WorldModel) -> dict[str, Any]:
    """The evaluation of a run so far; a new one if it was trained further."""
    steps = model.origin["steps"]
    if (folder / EVALUATION).is_file():
        found = storage.RUNS.read_evaluation(folder, columns=dict, planning=dict)
        same = {"settings": model.config.to_json(), "steps": steps, "measures": storage.RUNS.measures}
        if found.items() >= same.items():
            return found
    return {
        "schema": storage.RUNS.schema,
        "version": VERSION,
        "settings": model.config.to_json(),
        "steps": steps,
        "measures": storage.RUNS.measures,
        "columns": {},
        "planning": {},
        **provenance(),
    }


def publish_run(where: Comparison, config: WorldConfig, console: Console) -> None:
    """Train, measure and publish a run, or what is left of that."""
    folder = where.root / config.name

    def make() -> None:
        train(folder, config, console)
        evaluate(folder, PLANS, console)

    storage.RUNS.published_row(where, config, make)


def compare(where: Comparison, console: Console, only: Sequence[str] = ()) -> None:
    """Train what is missing, seed by seed, and write the document after each run.

    Args:
        where: folders.
        console: for progress.
        only: names of rows; by default all.

    Raises:
        ValueError: one line; there is no such row, or a folder holds another run.
    """
    wanted = wanted_rows(ROWS, only)
    for seed, name in product(SEEDS, wanted):
        publish_run(where, row_settings(name, seed), console)
        write_report(where)
    if where.weights is not None:
        folders = [where.root / row_settings(SHIPPED, seed).name for seed in SEEDS]
        if all(_is_whole(folder) for folder in folders):
            ship(folders, where.weights)
    say(console, f"Written: {where.out}")


def write_report(where: Comparison) -> None:
    """Write the document of the runs that are published.

    Raises:
        ValueError: one line; a file is damaged.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    missing = []
    for name, seed in product(ROWS, SEEDS):
        config = row_settings(name, seed)
        known = storage.RUNS.read_published(where.published / config.name, config)
        if known is None:
            missing.append(config.name)
        else:
            found.setdefault(name, []).append(known)
    folder = where.published / "bounds"
    bounds = report.Bounds(error_bounds(folder), frequent_outcomes(folder), planning_bounds(folder, PLANS))
    report.write(where.out, found, bounds, missing, provenance_facts())
