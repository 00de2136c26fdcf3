"""`make results`: every row of docs/results/results.md, seed by seed, from nothing or from where it stopped.

    python -m benchmarks.learning.agents --root build/results --out docs/results

Each row is an agent, each seed a run folder under the root. An interrupted run is resumed. Settings, log and scores of
an evaluated run are published beside the document, and such a run is not trained again. The document is written again
after each run and says what is still missing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

import iphyre_jax.models.world.prediction  # noqa: F401 - offers world models to the trainer
from benchmarks.learning.agents_document import document
from benchmarks.learning.rows import TableName, rows, without_sums
from iphyre_jax.checks import check_whole
from iphyre_jax.execution.configuration import configure
from iphyre_jax.files import read_json_object, replace_text
from iphyre_jax.memory import forget_programs
from iphyre_jax.scenes.library import ALL_GAMES
from iphyre_jax.train import loop
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.pool import with_sum
from iphyre_jax.train.predictions import open_prediction, with_prediction_sum
from iphyre_jax.train.reports import compare
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import runs
from iphyre_jax.train.storage.pretrained import rounded, save_pretrained
from iphyre_jax.train.trainer import RunState
from parity.command import run

SEEDS: Final = 5


@dataclass(frozen=True)
class Arguments:
    """Reproduce the results."""

    root: Path = Path("build/results")
    """Folder of the runs."""
    out: Path = Path("docs/results")
    """Folder of results.md, its pictures, and of runs/, what is published of each run."""
    table: TableName = "default"
    """Rows of results.md; "paper", of results-paper.md: the paper's twelve with its settings; "controllers", of
    results-controllers.md: agents that see predictions of world models."""
    only: tuple[str, ...] = ()
    """Rows to run, by name; by default all that are missing."""
    seeds: int = SEEDS
    """Seeds of each row."""
    weights: Path | None = None
    """Folder for the weights of each row's best seed, once all seeds are trained; by default they are not kept."""

    @property
    def stem(self) -> str:
        """Name of the document, and how those of its pictures begin."""
        return "results" if self.table == "default" else f"results-{self.table}"

    @property
    def published(self) -> Path:
        """Folder of what is published of each run."""
        return self.out / "runs"


def finished_run(folder: Path, config: TrainConfig, console: Console) -> RunState:
    """Train a run, or what is left of it; its last state.

    Raises:
        ValueError: one line; the folder holds a run with other settings, or a damaged checkpoint.
        KeyboardInterrupt: it was interrupted; what was made is saved.
    """
    if (folder / runs.CONFIG).is_file():
        check_settings(folder, runs.read_config(folder), config)
        result = loop.resume(folder, console)
    else:
        result = loop.train(config, folder, console)
    if not result.finished:
        raise KeyboardInterrupt
    return result.state


def check_settings(folder: Path, found: TrainConfig, wanted: TrainConfig) -> None:
    """Refuse a run with other settings than a row's, or whose files are others now.

    Sums of files are written down when a run starts.
    """
    if without_sums(found) != wanted:
        raise ValueError(f"{folder}: expected the settings of this row, found others; remove it")
    if _changed_files(found):
        raise ValueError(f"{folder}: its world model or scene pool is another one now; remove it")


def run_row(folder: Path, published: Path, config: TrainConfig, console: Console) -> None:
    """Train, evaluate and publish one seed of a row, or what is left of that.

    Args:
        folder: of the run.
        published: folder of what is published of it.
        config: settings of the run.
        console: for the progress.

    Raises:
        ValueError: one line; the folder holds a run with other settings, or a damaged checkpoint.
    """
    if is_evaluated(folder, config.updates):
        check_settings(folder, runs.read_config(folder), config)
    else:
        state = finished_run(folder, config, console)
        as_run = runs.read_config(folder)  # with the sums of its files
        runs.write_evaluation(folder, as_run, evaluate(as_run, state.learner, ALL_GAMES), int(state.update))
    runs.publish(folder, published)


def is_evaluated(folder: Path, updates: int) -> bool:
    """Whether a run was trained to its end and then played all games.

    `iphyre-jax evaluate` also evaluates runs that were interrupted, older checkpoints, and other games.
    """
    if not (folder / runs.EVALUATION).is_file():
        return False
    found = compare.read(folder)
    return found.updates == updates and set(ALL_GAMES) <= set(found.games)


def is_published(folder: Path, config: TrainConfig) -> bool:
    """Whether a folder has an evaluated run with these settings; one with others, or other files, is out of date."""
    if not is_evaluated(folder, config.updates):
        return False
    found = runs.read_config(folder)
    return without_sums(found) == config and not _changed_files(found)


def _changed_files(config: TrainConfig) -> bool:
    """Whether the scene pool of a run is another one now, or its world model, if that is there."""
    now = with_sum(without_sums(config))
    is_there = config.world_model and Path(config.prediction).is_dir()
    now = with_prediction_sum(now) if is_there else replace(now, prediction_sha256=config.prediction_sha256)
    return now != config


def export_best(arguments: Arguments, name: str, config: TrainConfig) -> None:
    """Write the weights of a row's best seed, by greedy reward on the basic and unseen basic games (no test games).

    Nothing is written unless all seeds are there, trained and evaluated with the settings of the row.
    """
    wanted = {arguments.root / name / f"seed-{seed}": replace(config, seed=seed) for seed in range(arguments.seeds)}
    if arguments.weights is None or not all(is_published(*run) for run in wanted.items()):
        return
    folders = list(wanted)
    seeds = [compare.read(folder) for folder in folders]
    rewards = [float(np.mean(run.scores("greedy", "basic") + run.scores("greedy", "unseen_basic"))) for run in seeds]
    best = int(np.argmax(rewards))
    config, state = runs.load(folders[best])
    about = read_json_object(folders[best] / runs.CONFIG)
    origin = {
        "chosen": f"best of {len(seeds)} seeds by greedy reward on the basic and unseen basic games",
        "trained": {key: about[key] for key in ("started", "versions", "device", "machine", "commit")},
    }
    kept = rounded(config, state.learner)
    save_pretrained(name, config, kept, evaluate(config, kept, ALL_GAMES).to_json(), origin, arguments.weights)


def main(arguments: Arguments) -> None:
    """Run what is missing and write the document."""
    check_whole("seeds", arguments.seeds)
    configure()
    console, table, seeds = Console(), rows(arguments.table), range(arguments.seeds)
    names = arguments.only or tuple(table)
    for name in arguments.only:
        if name not in table:
            raise ValueError(f"only: expected some of {', '.join(table)}, got {name!r}")
    write(arguments, table)
    wanted = {Path(n) / f"seed-{seed}": replace(table[n], seed=seed) for seed, n in product(seeds, names)}
    left = {part: config for part, config in wanted.items() if not is_published(arguments.published / part, config)}
    for plain in {replace(config, seed=0) for config in left.values()}:
        open_prediction(plain)  # before anything is trained: its world model must be there
    for part, config in left.items():
        run_row(arguments.root / part, arguments.published / part, config, console)
        write(arguments, table)
        forget_programs()
    for name in names:
        if table[name].agent != "random":
            export_best(arguments, name, table[name])


def write(arguments: Arguments, table: Mapping[str, TrainConfig]) -> None:
    """Write the document of what is there."""
    evaluated, missing = [], []
    for name in table:
        absent = []
        for seed in range(arguments.seeds):
            folder = arguments.published / name / f"seed-{seed}"
            if is_published(folder, replace(table[name], seed=seed)):
                evaluated.append(compare.read(folder))
            else:
                absent.append(str(seed))
        if absent:
            missing.append(f"{name} (seed {' '.join(absent)})")
    arguments.out.mkdir(parents=True, exist_ok=True)
    text = document(evaluated, missing, arguments.out, arguments.stem)
    replace_text(arguments.out / f"{arguments.stem}.md", text)


if __name__ == "__main__":
    sys.exit(run(main, Arguments))
