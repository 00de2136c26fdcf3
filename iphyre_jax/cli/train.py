"""`iphyre-jax train`, `resume`, `evaluate`, `compare`. Need the extra `train`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich import box
from rich.console import Console
from rich.table import Table

import iphyre_jax.models.world.prediction  # noqa: F401 - offers world models to the trainer
from iphyre_jax.attempts.metrics import auccess, best_reward, solved_curve
from iphyre_jax.attempts.policies import policy_attempts
from iphyre_jax.attempts.protocol import MOST_ATTEMPTS
from iphyre_jax.checks import check_option, check_whole
from iphyre_jax.cli.console import option
from iphyre_jax.cli.main import INTERRUPTED
from iphyre_jax.cli.signals import exit_code, interrupting
from iphyre_jax.files import check_apart, check_output, check_writable
from iphyre_jax.scenes import GAMES, SceneLike, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, GAME_LISTS, check_names_differ, load_own_scenes
from iphyre_jax.train import loop
from iphyre_jax.train.ahead import compiled_ahead
from iphyre_jax.train.ensemble import ensemble
from iphyre_jax.train.evaluate import OTHER, OWN, Evaluation, evaluate
from iphyre_jax.train.reports import compare
from iphyre_jax.train.reports.printing import print_table, say
from iphyre_jax.train.reports.report import COLUMNS, TITLES, other_splits, split_rows
from iphyre_jax.train.settings import old_names
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import TrainConfig, preset
from iphyre_jax.train.storage import pretrained, runs
from iphyre_jax.train.trainer import RunState

ATTEMPT_RUNS = 5  # of `evaluate --attempts`
CHOSEN_FIRST = {"agent": "ppo", "strategy": None, "preset": "default"}  # they decide the other defaults


@dataclass(frozen=True)
class Train:
    """Train an agent, evaluate it on the 40 games and the scene files that it was trained on, and write a run folder.

    The options --agent, --strategy and --preset decide the other defaults; add --help to see them.
    """

    config: Annotated[TrainConfig, tyro.conf.OmitArgPrefixes, tyro.conf.AvoidSubcommands] = field(
        default_factory=preset
    )
    out: Path | None = None
    """The run folder, new or empty; by default a new one under runs/."""
    evaluate: bool = True
    """Play the 40 games at the end, and the scene files that it was trained on."""


@dataclass(frozen=True)
class Resume:
    """Continue an interrupted run, to the same bits as an uninterrupted one, and evaluate it."""

    run: tyro.conf.Positional[Path]
    """The run folder."""
    checkpoint: str | None = None
    """Name of the checkpoint to continue from; by default the newest."""
    evaluate: bool = True
    """As in `train`."""


@dataclass(frozen=True)
class Evaluate:
    """Evaluate the policy of a run again and rewrite its evaluation.json and evaluation.md."""

    run: tyro.conf.Positional[Path]
    """The run folder."""
    checkpoint: str | None = None
    """Name of the checkpoint to evaluate; by default the newest."""
    unseen: bool = False
    """Play the ten unseen basic games too."""
    scenes: tuple[Path, ...] = ()
    """Play these scene files too, besides those that the run was trained on."""
    ensemble: tuple[Path, ...] = ()
    """Run folders of the same settings with other seeds: evaluate all policies as one, and write ensemble.json and
    ensemble.md instead."""
    attempts: int | None = None
    """Also let the policy try each game so often, blind: greedy first, then sampled; print how soon it solves them."""


@dataclass(frozen=True)
class Compare:
    """Compare evaluated runs: one row an agent, with mean and spread over its seeds."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folders, all of one frame rate."""
    curves: Path | None = None
    """Draw the learning curves into this picture."""
    bars: Path | None = None
    """Draw rewards by split, with the human line, into this picture."""


@dataclass(frozen=True)
class VerifyPretrained:
    """Play the games with a policy of the package and check that it reaches its published scores.

    The exit code is 1 if a score differs.
    """

    name: Annotated[tyro.conf.Positional[str], option("NAME", "Name of the policy, such as ppo-i.")]


TrainingCommand = Train | Resume | Evaluate | Compare


def defaults(arguments: Sequence[str]) -> Train:
    """The defaults of `train`, given its arguments: the preset that they name.

    Raises:
        ValueError: one line; there is no such agent, strategy or preset.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name, value in CHOSEN_FIRST.items():
        parser.add_argument(f"--{name}", default=value)
    try:
        known, _ = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError:  # an option without its value: the real parser reports it
        return Train()
    strategies = AGENTS[known.agent].strategies if known.agent in AGENTS else ("in-advance",)
    return Train(preset(known.agent, known.strategy or strategies[0], known.preset))


def renamed(arguments: Sequence[str]) -> list[str]:
    """Arguments of `train` with present names; each old one gets a line on the standard error."""
    present = old_names.options(arguments)
    for old, new in zip(arguments, present, strict=True):
        if old != new:
            print(f"DeprecationWarning: {old} is now {new}; the next version drops the old name", file=sys.stderr)
    return present


def run(command: TrainingCommand, console: Console) -> int:
    """Run a training command and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    with interrupting() as signals:
        try:
            code = _run(command, console)
        except KeyboardInterrupt:
            if not signals:
                raise
            code = INTERRUPTED
    return exit_code(signals[0]) if signals and code == INTERRUPTED else code


def _run(command: TrainingCommand, console: Console) -> int:
    """Run a training command and return the exit code; INTERRUPTED if a signal ended it early."""
    if isinstance(command, Train):
        command.config.check_start()
        with compiled_ahead(command.config, _others(command.config) if command.evaluate else ()):
            return _finish(loop.train(command.config, command.out, console), console, command.evaluate)
    if isinstance(command, Resume):
        config = runs.read_config(command.run)
        with compiled_ahead(config, _others(config) if command.evaluate else ()):
            return _finish(loop.resume(command.run, console, command.checkpoint), console, command.evaluate)
    if isinstance(command, Evaluate):
        if command.attempts is not None:
            check_whole("attempts", command.attempts, 1, MOST_ATTEMPTS)
        config, state = _policy(command)
        check_writable(command.run, str(command.run))
        runs.check_scenes(command.run, config)
        games = _evaluated(config, command.unseen, command.scenes)
        _evaluate_and_report(command.run, config, state, games, console, command.ensemble)
        if command.attempts is not None:
            _print_attempts(config, state, games, command.attempts, console)
        return 0
    for name in ("curves", "bars"):
        check_output(name, getattr(command, name), (".png", ".pdf", ".svg"))
    check_apart("bars", command.bars, "curves", command.curves)
    compare.report(command.runs, console, curves=command.curves, bars=command.bars)
    return 0


def _evaluated(config: TrainConfig, unseen: bool = False, scenes: Sequence[Path] = ()) -> tuple[SceneLike, ...]:
    """The games and scenes that a policy is evaluated on; those of one's own come last, see `evaluate`."""
    own = load_own_scenes((*config.games, *scenes))
    check_names_differ("scenes", [*map(load_scene, ALL_GAMES), *own])
    return (*(ALL_GAMES if unseen else GAMES), *own)


def _others(config: TrainConfig) -> tuple[str, ...]:
    """The games that are evaluated but not trained on, the last first: those with most objects compile longest."""
    return tuple(game for game in reversed(GAMES) if game not in config.training_games)


def _finish(result: loop.TrainingResult, console: Console, evaluated: bool) -> int:
    """Evaluate a finished run, if asked to; say how to continue an unfinished one."""
    if not result.finished:
        option = "" if evaluated else " --no-evaluate"
        say(console, f"Saved in {result.folder}; `iphyre-jax resume {result.folder}{option}` continues it,")
        say(console, f"`iphyre-jax evaluate {result.folder}` evaluates it as it is.")
        return INTERRUPTED
    if not evaluated:
        return 0
    config = runs.read_config(result.folder)
    _evaluate_and_report(result.folder, config, result.state, _evaluated(config), console)
    return 0


def _policy(command: Evaluate) -> tuple[TrainConfig, RunState]:
    """Settings and state of the run to evaluate, or of it and others as one policy."""
    config, state = runs.load(command.run, command.checkpoint)
    if not command.ensemble:
        return config, state
    others = (runs.load(path, command.checkpoint) for path in command.ensemble)
    configs, states = zip((config, state), *others, strict=True)
    if len({one.seed for one in configs}) < len(configs):
        raise ValueError(f"ensemble: expected runs of different seeds, got {', '.join(str(c.seed) for c in configs)}")
    if len({runs.scene_sums_of(path) for path in (command.run, *command.ensemble)}) > 1:
        raise ValueError("ensemble: expected runs on the same scenes, got others of one name")
    return config, state._replace(learner=ensemble(configs, [one.learner for one in states]))


def _evaluate_and_report(
    folder: Path,
    config: TrainConfig,
    state: RunState,
    games: Sequence[SceneLike],
    console: Console,
    others: Sequence[Path] = (),
) -> None:
    """Play the games, write the evaluation into the folder and print the table by split."""
    with console.status(f"evaluating on {len(games)} games"):
        evaluation = evaluate(config, state.learner, games)
    members = tuple(path.resolve().name for path in (folder, *others)) if others else ()
    runs.write_evaluation(folder, config, evaluation, int(state.update), members)
    _print_splits(evaluation, config, console)
    written = runs.OF_ENSEMBLE if others else runs.EVALUATION
    say(console, f"More in {(folder / written).with_suffix('.md')}")


def _print_attempts(
    config: TrainConfig, state: RunState, games: Sequence[SceneLike], count: int, console: Console
) -> None:
    """Let the policy try each game `count` times, in five runs, and print the measures by split."""
    with console.status(f"{ATTEMPT_RUNS} runs of {count} attempts at {len(games)} games"):
        tried = policy_attempts(
            config,
            state.learner,
            count,
            greedy_first=True,
            games=games,
            runs=ATTEMPT_RUNS,
            fps=config.fps,
            resets=config.resets,
            seed=config.seed,
        )
    curve, best = solved_curve(tried.success), best_reward(tried.reward)
    columns = ("solved@1 %", f"solved@{count} %", f"AUCCESS@{count} %", f"best of {count}")
    table = Table(box=box.SIMPLE, pad_edge=False)
    for title in ("", *columns):
        table.add_column(title, justify="right" if title else "left")
    own = [scene.name for scene in load_own_scenes(config.games)]
    others = [name for name in tried.games if name not in (*ALL_GAMES, *own)]
    for split, names in {**GAME_LISTS, OWN: own, OTHER: others}.items():
        rows = [tried.games.index(name) for name in names if name in tried.games]
        if not rows:
            continue
        shares = (curve[rows, 0], curve[rows, -1], auccess(curve[rows]))
        table.add_row(TITLES[split], *(f"{100 * share.mean():.1f}" for share in shares), f"{best[rows, -1].mean():.1f}")
    say(console, f"Attempts at {config.fps} fps, greedy first, then sampled; mean of {ATTEMPT_RUNS} runs")
    print_table(console, table)


def verify_pretrained(command: VerifyPretrained, console: Console) -> int:
    """Play a policy of the package on its fifty games; return 0 if all scores equal the published ones, else 1."""
    policy = pretrained.load_pretrained(check_option("name", command.name, pretrained.names()))
    with console.status(f"evaluating on {len(ALL_GAMES)} games"):
        evaluation = evaluate(policy.config, policy.state, ALL_GAMES)
    _print_splits(evaluation, policy.config, console)
    different = pretrained.differences(policy, evaluation)
    for line in different:
        say(console, line)
    say(console, f"{len(different)} of {2 * len(ALL_GAMES)} scores differ from the published ones.")
    return 1 if different else 0


def _print_splits(evaluation: Evaluation, config: TrainConfig, console: Console) -> None:
    """Print the table by split, this run beside the paper's agents and humans."""
    say(console, f"Mean reward and success: {config.agent_name}")
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column()
    for split in COLUMNS:
        table.add_column(TITLES[split], justify="right")
    for row in split_rows(evaluation):
        table.add_row(row.name, *row.cells, style="bold" if row.ours else None)
    print_table(console, table)
    say(console, compare.RATES_OF_PAPER)
    for line in other_splits(evaluation):
        say(console, line)
    if evaluation.faults:
        say(console, f"The physics failed in {evaluation.faults} episodes; they count as not solved.")
