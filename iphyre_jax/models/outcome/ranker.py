"""Train the classifier that chooses among a policy's plans, on plays of the scenes that the policy may learn from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from rich.console import Console

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome import runs, storage
from iphyre_jax.models.outcome.plays.augmented import joined
from iphyre_jax.models.outcome.plays.hard import hard_plays
from iphyre_jax.models.outcome.plays.pool import pool_plays
from iphyre_jax.models.outcome.plays.sets import compact
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.training import Params, chosen
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import Scene

HELD: Final = 40  # one scene in so many is held out, to watch the training; nothing is chosen by it
REFINED_EPOCHS: Final = 40  # of a refinement ...
REFINED_RATE: Final = 3e-4  # ... and its first learning rate


def trained_ranker(
    folder: Path,
    generated: Sequence[Scene],
    config: OutcomeConfig,
    console: Console,
    fresh: Sequence[Callable[[], Sequence[Scene]]] = (),
) -> storage.OutcomeClassifier:
    """The ranker of a folder; what is missing is played and trained, or the rest of it.

    A refinement goes on from the ranker before it. It plays those random plans of fresh scenes that this one believes
    in, over half of which fail, and learns from all plays so far.

    Args:
        folder: of plays, run and network; for these scenes and settings alone. Refinements are in folders of it.
        generated: scenes to learn from, beside basic games and variations.
        config: settings with one seed.
        console: for progress.
        fresh: gives the scenes of each refinement, if they are needed; none for no refinement.

    Raises:
        ValueError: one line; the folder holds another ranker, or a damaged one.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    later, last = refined(config), stage_folder(folder, len(fresh))
    if config.name not in storage.names(last):
        plays = [pool_plays(generated, config, folder / "plays", console)]
        ranker = _stage(folder, config, plays, None, console)
        for number, scenes in enumerate(fresh):
            place = stage_folder(folder, number + 1)
            plays.append(hard_plays(scenes(), later, ranker.params, number, place / "plays", console))
            ranker = _stage(place, later, plays, ranker.params, console)
    return _loaded(last, later if fresh else config)


def refined(config: OutcomeConfig) -> OutcomeConfig:
    """Settings of a refinement."""
    return replace(config, epochs=REFINED_EPOCHS, learning_rate=REFINED_RATE)


def stage_folder(folder: Path, refinements: int) -> Path:
    """Where the ranker after so many refinements is kept."""
    return folder / f"refined-{refinements}" if refinements else folder


def _stage(
    folder: Path, config: OutcomeConfig, plays: Sequence[Dataset], params: Params | None, console: Console
) -> storage.OutcomeClassifier:
    """One training, from plays of which the last ones are new, and from the parameters of the stage before."""
    if config.name not in storage.names(folder):
        held = [each.game % HELD == 0 for each in plays]
        parts = [compact(each.select(~out)) for each, out in zip(plays, held, strict=True)]
        learned, watched = joined(parts), runs.sampled(compact(plays[-1].select(held[-1])))
        state = runs.train(folder / "run", config, learned, watched, console, params)
        kept = storage.rounded(chosen(config, state), 0)
        origin = {"seed": 0, "plays": len(learned), "scenes": len(learned.scenes), "trained": provenance()}
        storage.save_classifier(storage.OutcomeClassifier(config.name, config, kept, origin), folder)
    return _loaded(folder, config)


def _loaded(folder: Path, config: OutcomeConfig) -> storage.OutcomeClassifier:
    ranker = storage.load_classifier(config.name, folder)
    if ranker.config != config:
        name = next(name for name, value in config.to_json().items() if ranker.config.to_json()[name] != value)
        raise ValueError(f"{folder}: {name}: expected that of these settings, found another; remove the folder")
    return ranker
