"""`iphyre-jax collect`: make, verify and export data sets of plays. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console

from iphyre_jax.adapters.minari_writer import check_minari
from iphyre_jax.checks import show
from iphyre_jax.cli.console import option, refuse_unread
from iphyre_jax.cli.signals import with_status
from iphyre_jax.data import NAMED_SETS, Dataset, collect, load_dataset, named_set, save_dataset, verify
from iphyre_jax.data.arrays import ARRAYS
from iphyre_jax.data.dataset import SCHEMA
from iphyre_jax.data.draws import Plan
from iphyre_jax.data.minari_export import export_minari
from iphyre_jax.data.official_files import check_folder_names, check_no_lists, load_official, save_official
from iphyre_jax.data.plays_io import dataset_from_plays, read_player_lines
from iphyre_jax.data.recipe import MAX_DRAWS, PlanPolicy
from iphyre_jax.data.targets import journal_of_new
from iphyre_jax.envs.in_advance import action_to_times
from iphyre_jax.observations.official import start_observation
from iphyre_jax.plans import Rule, plan_to_steps
from iphyre_jax.rules import DECISIONS_PER_SECOND, NEVER, PEOPLE_FPS
from iphyre_jax.scenes import Scene, load_scene
from iphyre_jax.scenes.library import GAME_LISTS
from iphyre_jax.scenes.limits import OFFICIAL
from iphyre_jax.train.algos.base import State
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.reports.printing import say
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import pretrained, runs
from iphyre_jax.viewer.plays import holds_plays, iter_plays

PLANS_AT_ONCE = 256  # of a policy


@dataclass(frozen=True)
class Collect:
    """Make a data set of plays: random plans of games, or a set that has a name, or plays of files. Or verify one.

    A collection that is interrupted or killed goes on where it was when the same command is given again.
    """

    games: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        option("GAME ...", "Names of games, splits or scene files, or all.", "all forty games"),
    ] = ()
    out: Annotated[Path | None, option("FILE", "The file to write, NAME.npz; NAME.json goes beside it.", "")] = None
    named: Annotated[
        Literal["official", "test", "pairs", "basic-large", "variations", "graded"] | None,
        option(f"{{{','.join(NAMED_SETS)}}}", "Make this named set, unless the cache folder has it.", "none"),
    ] = None
    source: Annotated[
        Path | None,
        option("PATH", "Take the plays of a data set, a folder of official files, or a file of plays.", "none"),
    ] = None
    verify: Annotated[Path | None, option("FILE", "Play this data set again and compare.", "none")] = None
    official: Annotated[Path | None, option("FOLDER", "Write files of the official package too.", "none")] = None
    minari: Annotated[str | None, option("ID", "Write a Minari data set too; needs the extra minari.", "none")] = None
    successes: int = 50
    """Plays of each game that solve it."""
    failures: int = 50
    """Plays of each game that do not."""
    distribution: Literal["official", "uniform15", "policy", "mixed"] = "official"
    """Plans as the official function draws them; the same up to 15 s; of a policy; half of them near successes."""
    policy: Annotated[str | None, option("POLICY", "A pretrained policy or a run folder, planning in advance.", "")] = (
        None
    )
    form: Literal["fresh", "exact"] = "fresh"
    """Each play in a fresh space, or in the successive resets of one space, as the official loop does."""
    fps: Annotated[int | None, option("N", "Physics steps a second.", "60, or the policy's")] = None
    rule: Annotated[
        Rule | None,
        option(
            "{simulate,in_advance}",
            "How seconds become steps: as in the official data, or as for agents that plan ahead.",
            "simulate, or in_advance for a policy",
        ),
    ] = None
    resets: Annotated[
        int | None,
        option(
            "N",
            "Number of the reset in a reused physics space: 1 is a fresh space; official agents play after the second.",
            "1, or the policy's",
        ),
    ] = None
    seed: int = 0
    """Seed of the draws."""
    max_draws: int = MAX_DRAWS
    """Draws of one game at most."""
    sequences: bool = False
    """Keep the poses of what moves, ten a second."""
    pose_dtype: Literal["float32", "float64"] = "float32"
    """Number type of the poses."""

    @property
    def world_fps(self) -> int:
        """Physics steps a second of a set that no policy plays."""
        return PEOPLE_FPS if self.fps is None else self.fps


def run(command: Collect, console: Console) -> int:
    """Run the command and return the exit code; 1 if a data set is not what it says.

    Raises:
        ValueError, OSError: one line.
    """
    return with_status(lambda report: _run(command, console, report), console)


# What each way to make a set reads besides what it writes; the rest would be ignored.
_WRITTEN: Final = ("out", "official", "minari")
_CHOSEN: Final = ("games", "fps", "sequences")  # with a source only if it is a folder of official files
_READ: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"verify": (), "named": (*_CHOSEN, *_WRITTEN), "source": _WRITTEN}
)


def _check_options(command: Collect) -> None:
    """Refuse options that the chosen way would ignore; ValueError in one line."""
    for way, read in _READ.items():
        if getattr(command, way) is None:
            continue
        if command.source is not None and command.source.is_dir():
            read = (*read, *_CHOSEN)
        refuse_unread(command, (way, *read), f"with --{way}")
    if command.pose_dtype != "float32" and not command.sequences:
        raise ValueError(f"pose_dtype: expected none without --sequences, got {show(command.pose_dtype)}")


def _run(command: Collect, console: Console, report: Callable[[str], None]) -> int:
    _check_options(command)
    if command.verify is not None:
        dataset = load_dataset(command.verify)
        different = verify(dataset, report=report)
        for line in different or [f"{command.verify}: {len(dataset)} plays, all reproduced"]:
            say(console, line)
        return 1 if different else 0
    if not any((command.out, command.named, command.official, command.minari)):
        raise ValueError("out: expected the file to write, --out NAME.npz, or --named, --official or --minari")
    journal = None if command.out is None else journal_of_new(command.out, SCHEMA, ARRAYS, "out")
    if command.official is not None and command.official.exists() and not command.official.is_dir():
        raise ValueError(f"official: expected a folder, got the file {show(str(command.official))}")
    if command.official is not None and command.source is None:
        scenes = [load_scene(game) for game in _games(command.games or (() if command.named else ("all",)))]
        check_folder_names("games", scenes)
        check_no_lists("official", command.official, scenes)
    if command.minari is not None:
        check_minari(command.minari, "minari")
    dataset = _make(command, journal, report)
    if command.official is not None:
        check_no_lists("official", command.official, dataset.scenes)
        save_official(dataset, command.official)
    if command.minari is not None:
        export_minari(dataset, command.minari)
    _describe(dataset, command, console)
    return 0


def _make(command: Collect, journal: Path | None, report: Callable[[str], None]) -> Dataset:
    """Return the data set that the options ask for, saved if they name a file."""

    def save(dataset: Dataset) -> None:
        if command.out is not None:
            command.out.parent.mkdir(parents=True, exist_ok=True)
            save_dataset(dataset, command.out)

    if command.named is not None:
        games = _games(command.games) if command.games else None
        dataset = named_set(
            command.named,
            fps=command.world_fps,
            sequences=command.sequences,
            games=games,
            report=report,
        )
        save(dataset)
        return dataset
    if command.source is not None:
        return _load(command.source, command, journal, report, save)
    if command.distribution == "policy" and command.policy is None:
        raise ValueError("policy: expected a pretrained policy or a run folder for --distribution policy, got none")
    if command.distribution != "policy" and command.policy is not None:
        raise ValueError(f"policy: expected none without --distribution policy, got {show(command.policy)}")
    policy = None if command.policy is None else _trained(command.policy)
    fps, resets = (PEOPLE_FPS, 1) if policy is None else (policy[0].fps, policy[0].resets)
    rule: Rule = "simulate" if policy is None else "in_advance"
    return collect(
        _games(command.games or ("all",)),
        successes=command.successes,
        failures=command.failures,
        distribution=command.distribution,
        form=command.form,
        fps=fps if command.fps is None else command.fps,
        rule=rule if command.rule is None else command.rule,
        resets=resets if command.resets is None else command.resets,
        seed=command.seed,
        sequences=command.sequences,
        pose_dtype=command.pose_dtype,
        max_draws=command.max_draws,
        policy=None if policy is None else _plans_of(*policy),
        journal=journal,
        report=report,
        save=save,
    )


def _games(words: tuple[str, ...]) -> list[str]:
    """Return the games that words name, each once: games, scene files, splits or all."""
    return list(dict.fromkeys(game for word in words for game in GAME_LISTS.get(word, (word,))))


def _load(
    source: Path,
    command: Collect,
    journal: Path | None,
    report: Callable[[str], None],
    save: Callable[[Dataset], None],
) -> Dataset:
    """Return the plays of a source, saved."""
    if source.is_dir():
        return load_official(
            source,
            games=_games(command.games) if command.games else None,
            fps=command.world_fps,
            sequences=command.sequences,
            journal=journal,
            report=report,
            save=save,
        )
    dataset = _read(source)
    save(dataset)
    return dataset


def _read(source: Path) -> Dataset:
    """Return the plays of a file."""
    if source.suffix in (".npz", ".json") and source.with_suffix(".npz").exists():
        return load_dataset(source)
    if holds_plays(source):
        return dataset_from_plays(iter_plays(source, required=True))
    return dataset_from_plays([line.play for line in read_player_lines(source)])


def _trained(name: str) -> tuple[TrainConfig, State]:
    """Return settings and state of a pretrained policy or of a run; ValueError in one line for one that acts later."""
    if Path(name).is_dir():
        config, run_state = runs.load(Path(name))
        state = run_state.learner
    else:
        if name not in pretrained.names():
            known = ", ".join(pretrained.names())
            raise ValueError(f"policy: expected the folder of a run, or one of {known}; got {show(name)}")
        loaded = pretrained.load_pretrained(name)
        config, state = loaded.config, loaded.state
    if config.strategy != "in-advance":
        raise ValueError(f"policy: expected one that plans in advance, got {name}, which plays {config.strategy}")
    return config, state


def _plans_of(config: TrainConfig, state: State) -> PlanPolicy:
    """Return the sampled plans of a policy, as `collect` takes them."""
    agent = algorithm(config)

    def plans(scene: Scene, seed: int) -> Iterator[Plan]:
        obs, key = jnp.asarray(start_observation(load_scene(scene, OFFICIAL))[None]), jax.random.key(seed)
        number, blocks = 0, len(scene.eliminable_blocks)
        while True:
            sampled = agent.sample_action(state, jax.random.fold_in(key, number), obs, PLANS_AT_ONCE).action
            steps = plan_to_steps(action_to_times(np.asarray(sampled)), DECISIONS_PER_SECOND, "in_advance")
            tenths = np.full((len(steps), scene.limits.blocks), NEVER)
            tenths[:, :blocks] = steps[:, :blocks]
            yield from np.where(tenths == NEVER, np.nan, tenths / DECISIONS_PER_SECOND).tolist()
            number += 1

    return plans


def _describe(dataset: Dataset, command: Collect, console: Console) -> None:
    """Print what was made, and which games have fewer plays than were asked for, or others than the files say."""
    for number, (scene, entry) in enumerate(zip(dataset.scenes, dataset.manifest["scenes"], strict=True)):
        if entry.get("iterations", 0) is None:
            found = f"{entry['successes']} successes and {entry['failures']} failures"
            say(console, f"{scene.name}: only {found} in {entry['draws']} draws")
        if other := entry.get("other_labels", 0):
            ended = f"{other} of {np.count_nonzero(dataset.game == number)} plays end otherwise than the files say"
            say(console, f"{scene.name}: {ended}; some do in a fresh space, many if --fps is not that of the files")
    where = "" if command.out is None else f"{command.out}: "
    solved = int(dataset.success.sum())
    say(console, f"{where}{len(dataset)} plays of {len(dataset.scenes)} scenes, {solved} solved, {dataset.fps} fps")
