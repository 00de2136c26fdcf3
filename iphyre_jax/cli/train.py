"""`iphyre-jax train`, `resume`, `evaluate`, `compare`. Need the extra `train`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from iphyre_jax.cli.main import INTERRUPTED
from iphyre_jax.cli.viewer import evaluate_plays
from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.train import loop
from iphyre_jax.train.evaluate import Evaluation, evaluate
from iphyre_jax.train.reports import compare
from iphyre_jax.train.reports.report import COLUMNS, TITLES, agent_name, split_rows
from iphyre_jax.train.settings.presets import preset
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import pretrained, runs
from iphyre_jax.train.trainer import RunState

CHOSEN_FIRST = ("agent", "strategy", "preset")  # they decide what the other settings are by default


@dataclass(frozen=True)
class Train:
    """Train an agent, evaluate it on the 40 games and leave a run folder.

    --agent, --strategy and --preset decide the defaults of everything else; give them with --help to see those.
    """

    config: Annotated[TrainConfig, tyro.conf.OmitArgPrefixes, tyro.conf.AvoidSubcommands] = field(
        default_factory=TrainConfig
    )
    out: Path | None = None
    """The run folder, new or empty; by default a new one under runs/."""
    evaluate: bool = True
    """Play the 40 games at the end."""


@dataclass(frozen=True)
class Resume:
    """Go on with a run that was interrupted, to the same bits as if it had not been, and evaluate it."""

    run: tyro.conf.Positional[Path]
    """The run folder."""
    checkpoint: str | None = None
    """Name of the checkpoint to go on from; by default the newest."""
    evaluate: bool = True
    """Play the 40 games at the end."""


@dataclass(frozen=True)
class Evaluate:
    """Evaluate a run's policy again and rewrite its evaluation.json and evaluation.md.

    Or play a policy that ships with the package, whose scores must come out again; or score a file of plays.
    """

    run: tyro.conf.Positional[Path]
    """The run folder, a policy of the package by name, such as ppo-i, or a file of plays (JSON lines)."""
    checkpoint: str | None = None
    """Name of the checkpoint to evaluate; by default the newest."""
    unseen: bool = False
    """Play the ten unseen basic games too."""


@dataclass(frozen=True)
class Compare:
    """Compare evaluated runs: seeds of one agent become one row, a mean with its spread over the seeds."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folders, all of one frame rate."""
    curves: Path | None = None
    """Draw the learning curves into this picture."""
    bars: Path | None = None
    """Draw rewards by split, with the human line, into this picture."""


TrainingCommand = Train | Resume | Evaluate | Compare


def defaults(arguments: Sequence[str]) -> Train:
    """What `train` does by default, given its arguments: the preset they name.

    Raises:
        ValueError: one line; there is no such agent, strategy or preset.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    base = TrainConfig()
    for name in CHOSEN_FIRST:
        parser.add_argument(f"--{name}", default=getattr(base, name))
    try:
        known, _ = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError:  # an option without its value: the real parser says so
        return Train(base)
    return Train(preset(known.agent, known.strategy, known.preset))


def run(command: TrainingCommand, console: Console) -> int:
    """Do what a training command asks and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    if isinstance(command, Train):
        command.config.check()
        folder = command.out or runs.default_path(command.config)
        return _finish(loop.train(command.config, folder, console), console, command.evaluate)
    if isinstance(command, Resume):
        return _finish(loop.resume(command.run, console, command.checkpoint), console, command.evaluate)
    if isinstance(command, Evaluate):
        if command.run.is_file():
            evaluate_plays(command.run, console)
            return 0
        if not command.run.exists() and str(command.run) in pretrained.names():
            return _reproduce(str(command.run), console)
        config, state = runs.load(command.run, command.checkpoint)
        games = (*GAMES, *SPLITS["unseen_basic"]) if command.unseen else GAMES
        _evaluate_and_report(command.run, config, state, games, console)
        return 0
    compare.report(command.runs, console, curves=command.curves, bars=command.bars)
    return 0


def _finish(outcome: loop.Outcome, console: Console, evaluated: bool) -> int:
    """Evaluate a run that is finished, if so asked; say how to go on with one that is not."""
    if not outcome.finished:
        console.print(f"Saved in {outcome.folder}; `iphyre-jax resume {outcome.folder}` goes on,")
        console.print(f"`iphyre-jax evaluate {outcome.folder}` evaluates it as it is.")
        return INTERRUPTED
    if not evaluated:
        return 0
    config = runs.read_config(outcome.folder)
    _evaluate_and_report(outcome.folder, config, outcome.state, GAMES, console)
    return 0


def _evaluate_and_report(
    folder: Path, config: TrainConfig, state: RunState, games: Sequence[str], console: Console
) -> None:
    """Play the games, write the evaluation into the folder and print the table by split."""
    with console.status(f"evaluating on {len(games)} games"):
        evaluation = evaluate(config, state.learner, games)
    runs.write_evaluation(folder, config, evaluation, int(state.update))
    _print_splits(evaluation, config, console)
    console.print(f"More in {folder / 'evaluation.md'}")


def _reproduce(name: str, console: Console) -> int:
    """Play a policy of the package on its fifty games; 0 if all scores are those that it ships with."""
    policy = pretrained.load_pretrained(name)
    with console.status(f"evaluating on {len(pretrained.PLAYED)} games"):
        evaluation = evaluate(policy.config, policy.state, pretrained.PLAYED)
    _print_splits(evaluation, policy.config, console)
    different = pretrained.differences(policy, evaluation)
    for line in different:
        console.print(line)
    console.print(f"{len(different)} of {2 * len(pretrained.PLAYED)} scores are not those that it ships with.")
    return 1 if different else 0


def _print_splits(evaluation: Evaluation, config: TrainConfig, console: Console) -> None:
    """The table by split, this run beside the paper's agents and humans."""
    console.print(f"Mean reward and success: {agent_name(config)}")
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column()
    for split in COLUMNS:
        table.add_column(TITLES[split], justify="right", no_wrap=True)
    for row in split_rows(evaluation, config):
        table.add_row(row.name, *row.cells, style="bold" if row.ours else None)
    console.print(table)
    console.print("The paper's agents play at 10 fps, its humans (best of five attempts) and oracle at 60 fps.")
    if "unseen_basic" in evaluation.splits:
        for kind in ("greedy", "sampled"):
            score = evaluation.mean(kind, "unseen_basic")
            console.print(f"Unseen basic, {kind}: {score.reward:.1f} ({100 * score.success:.0f} %)")
    if evaluation.faults:
        console.print(f"{evaluation.faults} episodes ended with an unsound world and count as not solved.")
