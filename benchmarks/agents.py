"""`make results`: every row of docs/results/results.md, seed by seed, from nothing or from where it stopped.

    python -m benchmarks.agents --root build/results --out docs/results

Each row is an agent, each seed a run folder under the root. An interrupted run is resumed. Settings, log and scores of
an evaluated run are published beside the document, and such a run is not trained again. The document is written again
after each run and says what is still missing.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
import tyro
from rich.console import Console

import iphyre_jax.models.world.prediction  # noqa: F401 - offers world models to the trainer
from benchmarks import plots
from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.execution.configuration import configure
from iphyre_jax.files import read_json_object, replace_text
from iphyre_jax.memory import forget_programs
from iphyre_jax.provenance import provenance
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.train import loop
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.predictions import open_prediction, with_prediction_sum
from iphyre_jax.train.reports import compare
from iphyre_jax.train.reports.report import TITLES as SPLIT_TITLES
from iphyre_jax.train.reports.report import markdown_table, paper_numbers
from iphyre_jax.train.reports.statistics import Summary
from iphyre_jax.train.settings.agents import PPO, AgentName
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import PERFECT, ZEROS, TrainConfig, preset
from iphyre_jax.train.storage import logs, runs
from iphyre_jax.train.storage.pretrained import PLAYED, rounded, save_pretrained
from iphyre_jax.train.trainer import RunState

SEEDS: Final = 5
OFFICIAL: Final = (
    "The official stack: 200 iterations of 4,000 episodes of 150 steps, at a measured 43.6 us a step, take 5,200 s of "
    "simulation alone. Ours: everything counts, compilation too (but not in the last column)."
)
TableName = Literal["default", "paper", "controllers"]
CONTROLLERS: Final[tuple[AgentName, ...]] = ("ppo", "a2c", "sac")
MOVING: Final[tuple[StrategyName, ...]] = ("on-the-fly", "combined")  # see more than the start
PREDICTIONS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "none": {},
        "zeros": {"prediction": ZEROS},
        "mdrnn-400": {"prediction": "build/world/mdrnn-400-0"},
        "mdrnn-5000": {"prediction": "build/world/mdrnn-5000-0"},
        "objects": {"prediction": "build/world/objects-unlimited-0"},
        "perfect": {"prediction": PERFECT},
        "motion": {"observation": "motion"},
    }
)  # what an agent sees besides the official observation; run folders are those of `make results-world`
TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "results-controllers": "# Agents that see predictions\n\nTo the official observation comes the table 0.1 s "
        "later if nothing is removed now: by a world model that learned from basic games (seed 0 of its row), by the "
        "simulator (perfect), or zeros in its place. Perfect, and motion (the true velocities), bound what models give."
    }
)  # of documents that are not simply results
PAPER_BASIC: Final = paper_numbers()["agents"]["PPO-I"]["basic"][0]  # points


def rows(name: TableName = "default") -> Mapping[str, TrainConfig]:
    """The rows of a table by name.

    "default" and "paper" have the twelve of the paper with that preset; "default" has our own rows besides. All but its
    last row learn the training games alone, as the paper's do. "controllers" has agents that see predictions.
    """
    if name == "controllers":
        return MappingProxyType(controllers())
    own = {"ppo-i": QUICK, "ppo-i-smooth": SMOOTH, "ppo-i-objects": preset()} if name == "default" else {}
    configs = [preset(agent, strategy, name) for agent, spec in AGENTS.items() for strategy in spec.strategies]
    suffix = "" if name == "default" else f"-{name}"
    # The random agent has one row: its last, on the fly.
    table = {config.paper_name.lower() + suffix: config for config in configs}
    return MappingProxyType(table | own)


def controllers() -> dict[str, TrainConfig]:
    """Agents that act on the fly or combined, with each of PREDICTIONS.

    World models learned at 60 steps a second in a fresh space: so the agents play there.
    """
    table = {}
    for agent, strategy in product(CONTROLLERS, MOVING):
        plain = replace(preset(agent, strategy), fps=60, resets=1, observation="official")
        for name, changes in PREDICTIONS.items():
            table[f"{plain.paper_name.lower()}-{name}"] = replace(plain, **changes)
    return table


QUICK: Final = preset(name="quick")
SMOOTH: Final = replace(QUICK, fps=60, resets=1, updates=150, learner=PPO(std_floor=150.0, ent_coef=0.03))


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
    """Refuse a run with other settings than a row's; sums of files are written down when a run starts."""
    if _without_sums(found) != wanted:
        raise ValueError(f"{folder}: expected the settings of this row, found others; remove it")


def _without_sums(config: TrainConfig) -> TrainConfig:
    return replace(config, pool_sha256="", prediction_sha256="")


def run_row(folder: Path, published: Path, config: TrainConfig, console: Console) -> bool:
    """Train, evaluate and publish one seed of a row, or what is left of that; returns whether anything was left.

    Args:
        folder: of the run.
        published: folder of what is published of it.
        config: settings of the run.
        console: for the progress.

    Raises:
        ValueError: one line; the folder holds a run with other settings, or a damaged checkpoint.
    """
    if is_published(published, config):
        return False
    if (folder / runs.EVALUATION).is_file():
        check_settings(folder, runs.read_config(folder), config)
    else:
        state = finished_run(folder, config, console)
        as_run = runs.read_config(folder)  # with the sums of its files
        runs.write_evaluation(folder, as_run, evaluate(as_run, state.learner, PLAYED), int(state.update))
    runs.publish(folder, published)
    return True


def is_published(folder: Path, config: TrainConfig) -> bool:
    """Whether a run with these settings is published in a folder; one with others, or another model, is out of date."""
    if not (folder / runs.EVALUATION).is_file():
        return False
    found = runs.read_config(folder)
    return _without_sums(found) == config and not _changed_model(found)


def _changed_model(config: TrainConfig) -> bool:
    """Whether the world model of a run is there, and is another one now."""
    if config.prediction in ("", ZEROS, PERFECT) or not Path(config.prediction).is_dir():
        return False
    return with_prediction_sum(replace(config, prediction_sha256="")) != config


def export_best(arguments: Arguments, name: str) -> None:
    """Write the weights of a row's best seed, by greedy reward on the basic and unseen basic games (no test games)."""
    folders = [arguments.root / name / f"seed-{seed}" for seed in range(arguments.seeds)]
    if arguments.weights is None or not all((folder / runs.EVALUATION).is_file() for folder in folders):
        return
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
    save_pretrained(name, config, kept, evaluate(config, kept, PLAYED).to_json(), origin, arguments.weights)


def seconds_to_paper(run: compare.Evaluated) -> float | None:
    """Seconds until greedy plans first reach the paper's PPO-I on basic; None if they never do.

    Playing, learning and measuring count, from the end of the first update, which compiles.
    """
    lines = logs.read(run.path)
    for line in lines:
        if line["greedy_reward"] and float(line["greedy_reward"]) >= PAPER_BASIC:
            return float(line["seconds"]) - float(lines[0]["seconds"])
    return None


def _times(rows: Sequence[compare.Row]) -> str:
    """Wall time of each row, and time to the paper's PPO-I."""
    header = ["agent", "episodes", "decisions", "training, s (median)", f"s to {PAPER_BASIC:.1f} on basic (median)"]
    cells = []
    for row in rows:
        last = [logs.read(seed.path)[-1] for seed in row.seeds]
        reached = [seconds_to_paper(seed) for seed in row.seeds] if row.config.fps == OFFICIAL_FPS else [None]
        known = [seconds for seconds in reached if seconds is not None]
        to_paper = f"{np.median(known):.1f} ({len(known)} of {len(reached)} seeds)" if known else "-"
        middle = [float(np.median([float(line[name]) for line in last])) for name in ("episodes", "decisions")]
        wall = f"{np.median([float(line['seconds']) for line in last]):.0f}"
        cells.append([row.name, *(f"{value:,.0f}" for value in middle), wall, to_paper])
    return markdown_table(header, cells)


def document(all_runs: Sequence[compare.Evaluated], missing: Sequence[str], out: Path, stem: str) -> str:
    """The text of the document; draws its pictures."""
    commits = {str(read_json_object(run.path / runs.EVALUATION)["commit"]) for run in all_runs}
    origin = json.dumps({**provenance(), "commits of the runs": sorted(commits)}, indent=1)
    parts = [
        TITLES.get(stem, "# Results"),
        f"Written by `make {stem}`. Trained on the basic split only, or, where the row says so, on its variations and "
        "on generated scenes that are near no test game; everything else is zero shot. Greedy: one episode a game; "
        "sampled: 20, as the agent plays to learn, which is the paper's protocol. Cells: mean over "
        "seeds, share solved, [95 % bootstrap interval over seeds], interquartile mean over games and seeds. People "
        "and oracle of the paper played at 60 fps, its agents at 10. `runs/` has settings, log and scores of each run.",
        f"Still missing: {', '.join(missing)}." if missing else "Nothing is missing.",
    ]
    for fps in (10, 60):
        of_rate = [run for run in all_runs if run.config.fps == fps]
        if not of_rate:
            continue
        table = compare.rows(of_rate)
        predicting = with_predictions(table)
        parts.append(f"## {fps} fps")
        if predicting:  # too many rows for the other pictures
            picture = out / f"{stem}-{fps}fps.png"
            plots.predictions(predicting, picture)
            parts += [*_added(predicting), f"![reward by what is seen at {fps} fps]({picture.name})"]
        parts += [compare.markdown(table), _unseen(table), "### Time"]
        parts += [OFFICIAL] if fps == OFFICIAL_FPS else []
        parts.append(_times(table))
        for name, draw in () if predicting else (("curves", compare.draw_curves), ("bars", compare.draw_bars)):
            picture = out / f"{stem}-{name}-{fps}fps.png"
            draw(picture, table)
            parts.append(f"![{name} at {fps} fps]({picture.name})")
    parts += ["## Origin", f"```json\n{origin}\n```"]
    return "\n\n".join(parts) + "\n"


def with_predictions(table: Sequence[compare.Row]) -> dict[str, dict[str, compare.Row]]:
    """The rows of the table of controllers by agent and by what it sees; nothing if there are none."""
    found = {replace(_without_sums(row.config), seed=0): row for row in table}
    agents: dict[str, dict[str, compare.Row]] = {}
    for name, config in controllers().items():
        if config in found:
            seen = name.removeprefix(f"{config.paper_name.lower()}-")
            agents.setdefault(config.paper_name, {})[seen] = found[config]
    return agents


def _added(agents: Mapping[str, Mapping[str, compare.Row]]) -> list[str]:
    """What each prediction adds to the same agent's reward without one, by split."""
    parts = [
        "### What a prediction adds\n\nReward of sampled actions, less that of the same agent and seeds without a "
        "prediction, whose own reward is in the first column; [95 % bootstrap interval over seeds]. An interval around "
        "0: it does not help; of three seeds, intervals are rough. Where `perfect` does not help, no "
        "model's prediction can."
    ]
    for split in ("basic", "all"):
        cells = []
        for agent, seen in agents.items():
            plain = seen.get("none")
            own = plain.summary("sampled", split) if plain else None
            others = [seen.get(name) for name in PREDICTIONS if name != "none"]
            added = [compare.difference(row, plain, "sampled", split) if row and plain else None for row in others]
            cells.append([agent, f"{own.mean:.1f}" if own else "-", *map(_signed, added)])
        parts.append(markdown_table([SPLIT_TITLES[split], *PREDICTIONS], cells))
    return parts


def _signed(value: Summary | None) -> str:
    if value is None:
        return "-"
    return f"{value.mean:+.1f}" + ("" if np.isnan(value.low) else f" [{value.low:+.0f}, {value.high:+.0f}]")


def _unseen(rows: Sequence[compare.Row]) -> str:
    """The ten unseen layouts of the basic games."""
    cells = []
    for row in rows:
        values = [row.summary(kind, "unseen_basic") for kind in compare.KINDS]
        cells.append([row.name, *("-" if value is None else f"{value.mean:.1f}" for value in values)])
    return "### Unseen basic\n\n" + markdown_table(["agent", *compare.KINDS], cells)


def main(arguments: Arguments) -> None:
    """Run what is missing and write the document."""
    configure()
    console, table, seeds = Console(), rows(arguments.table), range(arguments.seeds)
    for name in arguments.only:
        if name not in table:
            raise SystemExit(f"only: expected some of {', '.join(table)}, got {name!r}")
    write(arguments, table)
    for name in arguments.only or table:
        folder = arguments.published / name
        if not all(is_published(folder / f"seed-{seed}", replace(table[name], seed=seed)) for seed in seeds):
            open_prediction(table[name])  # before anything is trained: its world model must be there
    for seed in seeds:
        for name in arguments.only or table:
            part, config = Path(name) / f"seed-{seed}", replace(table[name], seed=seed)
            if run_row(arguments.root / part, arguments.published / part, config, console):
                write(arguments, table)
                forget_programs()
    for name in arguments.only or table:
        if table[name].agent != "random":
            export_best(arguments, name)


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
    main(tyro.cli(Arguments))
