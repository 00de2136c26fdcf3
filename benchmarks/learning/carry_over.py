"""`make carry-over`: what carries over to unseen scenes from variations of the basic games and generated scenes.

    python -m benchmarks.learning.carry_over --fps 10
    python -m benchmarks.learning.carry_over --fps 10 --test    # plays the forty games too, and counts that it did

Each row differs from the default preset in one thing, is four policies of that preset as one, or lets a classifier
rank a policy's plans. They are compared on the unseen basic games and on generated scenes that were held out. The forty
games are played with --test only, each policy once: its first plan, then tries that differ. Everything goes on where it
stopped.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from rich.console import Console

from benchmarks.learning.agents import check_settings, finished_run
from benchmarks.learning.carry_over_document import document
from benchmarks.learning.carry_over_policy import DTYPE, RUNS, TRIES, Policy, forty_row, held_out_row, settings_of_row
from benchmarks.learning.carry_over_rows import (
    FRESH,
    FRESH_VARIATIONS,
    POOL,
    PROPOSING,
    RANKED,
    REFINEMENTS,
    ROWS,
    TRAINED_ON,
    UNIONS,
    WITH_UNIONS,
    Ranking,
    SceneFile,
    members,
    ranker_config,
    ranking_of,
    rows,
)
from benchmarks.learning.on_the_fly import counted
from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.attempts.agents import draw_randomly
from iphyre_jax.attempts.protocol import Agent
from iphyre_jax.checks import check_whole
from iphyre_jax.data.generated import generate_scenes, load_generated, save_generated
from iphyre_jax.execution.configuration import configure
from iphyre_jax.files import file_sum, replace_text
from iphyre_jax.kept_rows import Row, kept_row, read_row, read_rows, rows_there
from iphyre_jax.models.outcome.plays.augmented import scenes_of
from iphyre_jax.models.outcome.plays.proposals import proposals_of
from iphyre_jax.models.outcome.ranker import Refinement, stage_folder, trained_ranker
from iphyre_jax.models.outcome.storage import FILES, OutcomeClassifier, load_classifier
from iphyre_jax.models.outcome.storage import WEIGHTS as RANKERS
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import SPLITS, Scene
from iphyre_jax.train.algos.base import State
from iphyre_jax.train.ensemble import ensemble
from iphyre_jax.train.pool import with_sum
from iphyre_jax.train.settings.run import TrainConfig, preset
from iphyre_jax.train.storage import checkpoint, runs
from iphyre_jax.train.storage.pretrained import WEIGHTS, load_pretrained
from parity.command import run

SHIPPED: Final = "ppo-i-objects"  # the default preset, trained at 10 steps a second
SHIPPED_RANKED: Final = f"{SHIPPED}-ranked"  # that policy, whose plans the shipped classifiers rank
Evaluated = Literal["held-out", "forty"]  # scenes that a row was played on
EVALUATED: Final[tuple[Evaluated, ...]] = ("held-out", "forty")
COUNTER: Final = "forty-carry-over.json"  # how often this command has played the forty games


@dataclass(frozen=True)
class Arguments:
    """Train the default agent and what differs from it in one thing, and compare."""

    root: Path = Path("build/carry-over")
    """Folder of the pool and of the runs."""
    out: Path = Path("docs/results")
    """Folder of carry-over.md, of its rows and of the count of runs on the forty games."""
    fps: tuple[Literal[10, 60], ...] = (10, 60)
    """Rates to train at."""
    seeds: int = 5
    """Seeds of each row."""
    only: tuple[str, ...] = ()
    """Rows to train, by name; by default all."""
    train: bool = True
    """Train what is missing; else only play what is trained or ships and has no row, and write the document. The
    generated scenes must be there, or are generated."""
    test: bool = False
    """Play the forty games with what is trained, and count it."""
    weights: Path | None = None
    """Folder for the classifiers that rank plans, once they are trained; by default they are not kept."""

    @property
    def rows(self) -> Path:
        """Folder of the rows, which are published: what has its rows is not trained again."""
        return self.out / "carry-over"


def scene_file(root: Path, of: SceneFile = POOL) -> Path:
    """The path of generated scenes; they are generated if the file is missing."""
    file = of.path(root)
    if not file.is_file():
        root.mkdir(parents=True, exist_ok=True)
        journal = root / f"{of.name}.parts"
        save = partial(save_generated, path=file)
        generate_scenes(of.scenes, of.seed, kind=of.kind, journal=journal, report=print, save=save)
    return file


def fresh_scenes(root: Path, refinement: int) -> tuple[Scene, ...]:
    """Scenes of a refinement, which nothing has learned from before."""
    files, variations, _ = FRESH[refinement - 1]
    fresh = [load_generated(scene_file(root, file)).scenes for file in files]
    if variations is not None:
        fresh += [scenes_of(game, FRESH_VARIATIONS, variations) for game in SPLITS["basic"]]
    return tuple(chain.from_iterable(fresh))


def ranker_of(root: Path, fps: int, learned: Sequence[Scene], ranking: Ranking, console: Console) -> OutcomeClassifier:
    """The classifier of a rate, which serves all policies; what is missing is trained."""
    propose = proposals_of(partial(_proposing, root, fps, console))
    refinements = [
        Refinement(partial(fresh_scenes, root, number), propose if one.by_policies else None)
        for number, one in enumerate(FRESH[: ranking.refinements], 1)
    ]
    return trained_ranker(root / f"{fps}fps" / RANKED, learned, ranker_config(fps), console, refinements)


def _proposing(root: Path, fps: int, console: Console) -> list[tuple[TrainConfig, State]]:
    """The policies that propose plans; what is missing is trained."""
    plain = rows(root, fps)[WITH_UNIONS]
    found = [members(root, fps, WITH_UNIONS, plain, seed) for seed in range(PROPOSING)]
    return [trained(folder, config, console) for one in found for folder, config in one.items()]


def policy_of(runs_of_row: Mapping[Path, TrainConfig], console: Console) -> Policy:
    """A row's policy without its ranker; what is missing is trained."""
    loaded = [trained(folder, config, console) for folder, config in runs_of_row.items()]
    if len(loaded) == 1:
        return Policy(*loaded[0])
    configs, states = zip(*loaded, strict=True)
    return Policy(configs[0], ensemble(configs, states))


def trained(folder: Path, config: TrainConfig, console: Console) -> tuple[TrainConfig, State]:
    """Settings and state of a run, trained or what is left of it.

    Raises:
        ValueError: one line; the folder holds a run with other settings, or a damaged checkpoint.
    """
    if not is_trained(folder, config):
        state = finished_run(folder, config, console)
        return runs.read_config(folder), state.learner
    written, state = runs.load(folder)
    check_settings(folder, written, config)
    return written, state.learner


def is_trained(folder: Path, config: TrainConfig) -> bool:
    """Whether a run has made all its updates."""
    return f"{config.updates:06d}" in checkpoint.names(folder)


def play_forty(folder: Path, policies: Mapping[int, Mapping[str, Policy]], out: Path) -> None:
    """Play the forty games with whatever has no row yet, and count it if there is anything.

    Raises:
        ValueError: a row that is there has other settings; one line, before anything is played or counted.

    Args:
        folder: of the rows.
        policies: of each rate, by the names of their rows.
        out: folder of the count.
    """
    tasks: list[tuple[Path, str, dict[str, Any], Callable[[], Row]]] = []
    for fps in RESETS:
        of_rate = {**policies.get(fps, {}), **_shipped(fps)}
        agents: dict[str, Agent] = {name: one.agent() for name, one in of_rate.items()}
        for name, agent in {"random plans": draw_randomly, **agents}.items():
            settings = forty_settings(fps, name, of_rate[name].settings() if name in of_rate else {})
            tasks.append((_folder(folder, "forty", fps), name, settings, partial(forty_row, agent, fps)))
    there = [name in rows_there(place, {name: settings}) for place, name, settings, _ in tasks]
    if all(there):
        return
    counted(out / COUNTER)
    for place, name, settings, compute in tasks:
        kept_row(place, name, settings, compute)


def forty_settings(fps: int, name: str, policy: Mapping[str, Any]) -> dict[str, Any]:
    """What decides a row of the forty games: how they are played, the name, and the settings of its policy."""
    return {"fps": fps, "tries": TRIES, "runs": RUNS, "dtype": DTYPE, "seed": 0, "name": name, **policy}


def _shipped(fps: int) -> dict[str, Policy]:
    """The shipped policy at a rate, without and with the classifier that ships for this rate."""
    policy = load_pretrained(SHIPPED)
    config, sums = replace(policy.config, fps=fps, resets=RESETS[fps]), {"sha256": file_sum(WEIGHTS / f"{SHIPPED}.npz")}
    plain, name = Policy(config, policy.state, sums=sums), ranker_config(fps).name
    with_ranker = {**sums, "ranker_sha256": file_sum(RANKERS / f"{name}.npz")}
    ranked = replace(plain, ranker=load_classifier(name), ranking=Ranking(REFINEMENTS[fps]), sums=with_ranker)
    return {SHIPPED: plain, SHIPPED_RANKED: ranked}


def _ranker_folder(root: Path, fps: int, ranking: Ranking) -> Path | None:
    """Folder of a rate's classifier; None if it is not trained."""
    folder = stage_folder(root / f"{fps}fps" / RANKED, ranking.refinements)
    return folder if ranker_config(fps).name in FILES.names(folder) else None


def _ship(root: Path, weights: Path) -> None:
    """Write the refined classifiers that are trained into a folder."""
    for fps in RESETS:
        if (folder := _ranker_folder(root, fps, Ranking(REFINEMENTS[fps]))) is not None:
            FILES.save(weights, load_classifier(ranker_config(fps).name, folder))


def main(arguments: Arguments) -> None:
    """Train what is missing, play, and write the document."""
    check_whole("seeds", arguments.seeds)
    for name in arguments.only:
        if name not in ROWS:
            raise ValueError(f"only: expected some of {', '.join(ROWS)}, got {name!r}")
    configure()
    console, file = Console(), scene_file(arguments.root)
    if preset().fps in arguments.fps:
        scene_file(arguments.root, UNIONS)
    tables = {fps: rows(arguments.root, fps) for fps in sorted(arguments.fps)}
    generated = load_generated(file)
    learned, held_out = (generated.select(part).scenes for part in np.split(np.arange(len(generated)), [TRAINED_ON]))
    policies: dict[int, dict[str, Policy]] = {fps: {} for fps in tables}

    def keep_held_out(fps: int, name: str, policy: Policy) -> None:
        folder = _folder(arguments.rows, "held-out", fps)
        kept_row(folder, name, policy.settings(), partial(held_out_row, policy, held_out))

    for seed, fps in product(range(arguments.seeds), tables):
        for name, plain in tables[fps].items():
            runs_of_row = members(arguments.root, fps, name, plain, seed)
            wanted = arguments.train and (not arguments.only or name in arguments.only)
            ranking = ranking_of(name, fps)
            ranker = ranker_config(fps, ranking.refinements) if ranking else None
            held, forty = (_folder(arguments.rows, scenes, fps) / f"{name}-{seed}.json" for scenes in EVALUATED)
            if held.is_file():
                first = with_sum(next(iter(runs_of_row.values())))
                own = settings_of_row(first, len(runs_of_row), ranker, ranking)
                read_row(held, own)  # refuses one that is out of date
                if forty.is_file():
                    read_row(forty, forty_settings(fps, f"{name}-{seed}", own))
            known = held.is_file() and (forty.is_file() or not arguments.test)
            there = all(is_trained(*run) for run in runs_of_row.items())
            if ranking:
                there &= _ranker_folder(arguments.root, fps, ranking) is not None
            if known or not (wanted or there):
                continue
            one = policy_of(runs_of_row, console)
            if ranking:
                judge = ranker_of(arguments.root, fps, learned, ranking, console)
                one = replace(one, ranker=judge, ranking=ranking)
            policies[fps][f"{name}-{seed}"] = one
            keep_held_out(fps, f"{name}-{seed}", one)
            _write(arguments, generated.manifest)
    if arguments.weights is not None:
        _ship(arguments.root, arguments.weights)
    for fps in tables:
        for name, one in _shipped(fps).items():
            keep_held_out(fps, name, one)
    if arguments.test:
        play_forty(arguments.rows, policies, arguments.out)
    _write(arguments, generated.manifest)


def _folder(root: Path, scenes: Evaluated, fps: int) -> Path:
    """Folder of the rows on these scenes at a rate."""
    return root / f"{scenes}-{fps}fps"


def _write(arguments: Arguments, manifest: Mapping[str, Any]) -> None:
    """Write the document of the rows that are there."""
    held_out, forty = (
        {fps: read_rows(_folder(arguments.rows, scenes, fps)) for fps in sorted(RESETS)} for scenes in EVALUATED
    )
    missing = []
    for fps, found in held_out.items():
        for name in rows(Path(), fps):
            if seeds := [str(seed) for seed in range(arguments.seeds) if f"{name}-{seed}" not in found]:
                missing.append(f"{name} at {fps} steps a second (seeds {', '.join(seeds)})")
    facts = {"pool": {key: manifest[key] for key in ("seed", "scenes", "protocol", "nearest_px")}, **provenance()}
    arguments.out.mkdir(parents=True, exist_ok=True)
    text = document(held_out, forty, missing, arguments.out / COUNTER, facts)
    replace_text(arguments.out / "carry-over.md", text)


if __name__ == "__main__":
    sys.exit(run(main, Arguments))
