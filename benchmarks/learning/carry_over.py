"""`make carry-over`: what carries over to unseen scenes from variations of the basic games and generated scenes.

    python -m benchmarks.learning.carry_over --fps 10
    python -m benchmarks.learning.carry_over --fps 10 --test    # plays the forty games too, and counts that it did

Each row differs from the default preset in one thing, is four policies of that preset as one, or lets a classifier
rank a policy's plans. They are compared on the unseen basic games and on generated scenes that were held out. The forty
games are played with --test only, each policy once: its first plan, then tries that differ. Everything goes on where it
stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
import tyro
from rich.console import Console

from benchmarks.learning.agents import check_settings, finished_run
from benchmarks.learning.carry_over_document import document
from benchmarks.learning.carry_over_policy import DTYPE, RUNS, TRIES, Policy, forty_row, held_out_row, settings_of_row
from benchmarks.learning.on_the_fly import counted
from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.attempts.agents import draw_randomly
from iphyre_jax.attempts.protocol import Agent
from iphyre_jax.data.generated import generate_scenes, load_generated, save_generated
from iphyre_jax.execution.configuration import configure
from iphyre_jax.files import replace_text
from iphyre_jax.kept_rows import Row, kept_row, read_row, read_rows
from iphyre_jax.models.outcome.ranker import trained_ranker
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.settings import settings as outcome_settings
from iphyre_jax.models.outcome.storage import names as classifier_names
from iphyre_jax.provenance import provenance
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.train.algos.base import State
from iphyre_jax.train.ensemble import ensemble
from iphyre_jax.train.pool import with_sum
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig, preset
from iphyre_jax.train.storage import checkpoint, runs
from iphyre_jax.train.storage.pretrained import load_pretrained

SCENES: Final = 20_000  # of the pool's file, seed 0
TRAINED_ON: Final = 19_000  # the first ones; the others are held out
MEMBERS: Final = 4  # policies of an ensemble; five were no better on held-out scenes
EVERY: Final = 64  # topologies at most; the generator knows fewer
FEWER: Final = 1_000  # of those that ship, for the row with a small pool
SHIPPED: Final = "ppo-i-objects"  # the default preset, trained at 10 steps a second
Evaluated = Literal["held-out", "forty"]  # scenes that a row was played on
EVALUATED: Final[tuple[Evaluated, ...]] = ("held-out", "forty")
ENSEMBLE: Final = "ensemble"
LARGE_BATCH: Final = "large-batch"
RANKED: Final = "ranked"  # those policies, whose plans a classifier ranks
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
    """Train what is missing; else only write the document of what is there."""
    test: bool = False
    """Play the forty games with what is trained, and count it."""

    @property
    def rows(self) -> Path:
        """Folder of the rows, which are published: what has its rows is not trained again."""
        return self.out / "carry-over"


def rows(pool: Path, fps: int) -> Mapping[str, TrainConfig]:
    """The rows of a rate by name: the default preset, and what differs from it in one thing.

    A larger pool takes more updates, or updates of twice the episodes, for which the learning rate is higher and
    minibatches are of whole scenes. The scenes that ship are the first ones of the pool.
    """
    base = replace(preset(), fps=fps, resets=RESETS[fps])
    large = replace(base, scene_pool=str(pool), pool_scenes=TRAINED_ON)
    batch = replace(
        large,
        updates=240,
        episodes_per_scene=2 * base.episodes_per_scene,
        pool_topologies=EVERY,
        learner=PPO(learning_rate=6e-4, epochs=3, kl_coef=0.2, minibatch_of="scenes"),
    )
    return MappingProxyType(
        {
            "default": base,
            "variations": replace(base, scene_pool=""),
            "generated": replace(base, variations=0, pool_share=1.0),
            "large-pool": replace(large, updates=2 * base.updates),
            LARGE_BATCH: batch,
            "small-pool": replace(base, pool_scenes=FEWER),
            "uniform": replace(base, curriculum="uniform"),
            "small-network": replace(base, hidden_sizes=(64, 64)),
            ENSEMBLE: base,
            RANKED: batch,
        }
    )


def members(root: Path, fps: int, name: str, plain: TrainConfig, seed: int) -> dict[Path, TrainConfig]:
    """Folders and settings of the runs of a row's policy: one, or the next MEMBERS of the default preset."""
    count, run = {ENSEMBLE: (MEMBERS, "default"), RANKED: (1, LARGE_BATCH)}.get(name, (1, name))
    folder = root / f"{fps}fps" / run
    return {folder / f"seed-{k}": replace(plain, seed=k) for k in range(count * seed, count * (seed + 1))}


ROWS: Final = tuple(rows(Path(), OFFICIAL_FPS))  # their names, the same at all rates


def pool_file(root: Path) -> Path:
    """The pool's file; generated if it is missing."""
    file = root / "pool.npz"
    if not file.is_file():
        root.mkdir(parents=True, exist_ok=True)
        save_generated(generate_scenes(SCENES, journal=root / "pool.parts", report=print), file)
    return file


def policy_of(runs_of_row: Mapping[Path, TrainConfig], console: Console) -> Policy:
    """A row's policy without its ranker; what is missing is trained."""
    loaded = [trained(folder, config, console) for folder, config in runs_of_row.items()]
    if len(loaded) == 1:
        return Policy(*loaded[0])
    configs, states = zip(*loaded, strict=True)
    return Policy(configs[0], ensemble(configs, states))


def ranker_config(fps: int) -> OutcomeConfig:
    """Settings of a rate's ranker, one for all policies of the row."""
    return replace(outcome_settings("ranker"), fps=fps, resets=RESETS[fps])


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

    Args:
        folder: of the rows.
        policies: of each rate, by the names of their rows.
        out: folder of the count.
    """
    tasks: list[tuple[Path, str, dict[str, Any], Callable[[], Row]]] = []
    for fps in RESETS:
        of_rate = {**policies.get(fps, {}), SHIPPED: _shipped(fps)}
        agents: dict[str, Agent] = {name: one.agent() for name, one in of_rate.items()}
        for name, agent in {"random plans": draw_randomly, **agents}.items():
            settings = {"fps": fps, "tries": TRIES, "runs": RUNS, "dtype": DTYPE, "seed": 0, "name": name}
            if name in of_rate:
                settings.update(of_rate[name].settings())
            tasks.append((_folder(folder, "forty", fps), name, settings, partial(forty_row, agent, fps)))
    if all((place / f"{name}.json").is_file() for place, name, *_ in tasks):
        return
    counted(out / COUNTER)
    for place, name, settings, compute in tasks:
        kept_row(place, name, settings, compute)


def _shipped(fps: int) -> Policy:
    policy = load_pretrained(SHIPPED)
    return Policy(replace(policy.config, fps=fps, resets=RESETS[fps]), policy.state)


def main(arguments: Arguments) -> None:
    """Train what is missing, play, and write the document."""
    for name in arguments.only:
        if name not in ROWS:
            raise SystemExit(f"only: expected some of {', '.join(ROWS)}, got {name!r}")
    configure()
    console, file = Console(), pool_file(arguments.root)
    tables = {fps: rows(file, fps) for fps in sorted(arguments.fps)}
    generated = load_generated(file)
    learned, held_out = (generated.select(part).scenes for part in np.split(np.arange(len(generated)), [TRAINED_ON]))
    policies: dict[int, dict[str, Policy]] = {fps: {} for fps in tables}

    def keep_held_out(fps: int, name: str, policy: Policy) -> None:
        folder = _folder(arguments.rows, "held-out", fps)
        kept_row(folder, name, policy.settings(), partial(held_out_row, policy, held_out))

    for fps in tables:
        keep_held_out(fps, SHIPPED, _shipped(fps))
    for seed, fps in product(range(arguments.seeds), tables):
        for name, plain in tables[fps].items():
            runs_of_row = members(arguments.root, fps, name, plain, seed)
            wanted = arguments.train and (not arguments.only or name in arguments.only)
            ranker = ranker_config(fps) if name == RANKED else None
            held, forty = (_folder(arguments.rows, scenes, fps) / f"{name}-{seed}.json" for scenes in EVALUATED)
            if held.is_file():
                first = with_sum(next(iter(runs_of_row.values())))
                read_row(held, settings_of_row(first, len(runs_of_row), ranker))  # refuses one that is out of date
            known = held.is_file() and (forty.is_file() or not arguments.test)
            folder = arguments.root / f"{fps}fps" / RANKED
            there = all(is_trained(*run) for run in runs_of_row.items())
            if ranker is not None:
                there &= ranker.name in classifier_names(folder)
            if known or not (wanted or there):
                continue
            one = policy_of(runs_of_row, console)
            if ranker is not None:
                one = replace(one, ranker=trained_ranker(folder, learned, ranker, console))
            policies[fps][f"{name}-{seed}"] = one
            keep_held_out(fps, f"{name}-{seed}", one)
            _write(arguments, generated.manifest)
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
    for (fps, found), name in product(held_out.items(), ROWS):
        if seeds := [str(seed) for seed in range(arguments.seeds) if f"{name}-{seed}" not in found]:
            missing.append(f"{name} at {fps} steps a second (seeds {', '.join(seeds)})")
    facts = {"pool": {key: manifest[key] for key in ("seed", "scenes", "protocol", "nearest_px")}, **provenance()}
    arguments.out.mkdir(parents=True, exist_ok=True)
    text = document(held_out, forty, missing, arguments.out / COUNTER, facts)
    replace_text(arguments.out / "carry-over.md", text)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
