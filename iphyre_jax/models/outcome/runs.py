"""Train a row, or go on where it stopped, and measure it. A run killed at any moment ends with the same bits."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from rich.console import Console

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.files import replace_json
from iphyre_jax.locks import locked
from iphyre_jax.models.outcome import metrics, storage
from iphyre_jax.models.outcome.plays.inputs import examples, scene_inputs
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.training import (
    History,
    Material,
    OutcomeState,
    Params,
    chosen,
    predict,
    start,
    train_chunk,
)
from iphyre_jax.models.storage import EVALUATION, VERSION, check_losses, parameter_count
from iphyre_jax.provenance import provenance
from iphyre_jax.train.progress import training_progress

SAMPLE: Final = 5000  # plays of the training set that are judged, if it is larger
GREAT: Final = 200  # scenes of a data set from which on it has no column for each game


def material_of(config: OutcomeConfig, learned: Dataset, held: Dataset) -> Material:
    """What training reads: plays to learn from, and held-out ones to choose by."""
    parts = [
        part for plays in (learned, held) for part in (scene_inputs(plays.scenes, config), examples(plays, config))
    ]
    return Material(*jax.device_put(parts))


@default_options()
def train(
    folder: Path,
    config: OutcomeConfig,
    learned: Dataset,
    held: Dataset,
    console: Console,
    params: Params | None = None,
) -> OutcomeState:
    """Train the networks of a row, or what is left of it.

    Args:
        folder: of the run; a new one, or one with the same settings and plays.
        config: settings.
        learned: plays to learn from.
        held: plays to choose the epoch by.
        console: for the progress bar.
        params: of trained networks, to go on from; None to begin anew.

    Raises:
        ValueError: one line; the folder holds another run, or a damaged one, or training has diverged.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        sums = [{"count": len(plays), "sha256": storage.plays_sum(plays)} for plays in (learned, held)]
        storage.RUNS.create(folder, config, plays=sums[0], held=sums[1])
        material = material_of(config, learned, held)
        state, history = start(config, material, params), History(*[jnp.zeros((0, config.seeds))] * 3)
        if (saved := storage.load(folder, state)) is not None:
            state, history = saved
        with training_progress(console) as progress:
            bar = progress.add_task(config.name, total=config.epochs, completed=len(history.loss), status="compiling")
            for first in range(len(history.loss), config.epochs, config.chunk):
                state, made = train_chunk(config, material, jnp.int32(first), state)
                check_losses(folder, made.loss, f"epoch {first}")
                history = History(*(jnp.concatenate(pair) for pair in zip(history, made, strict=True)))
                storage.save(folder, state, history)
                status = f"loss {history.loss[-1].mean():.3f}  held out {100 * history.held_accuracy[-1].mean():.1f} %"
                progress.update(bar, advance=config.chunk, status=status)
    return state


@default_options()
def judge(config: OutcomeConfig, params: Any, plays: Dataset) -> npt.NDArray[np.float64]:  # noqa: ANN401 - a tree
    """The chance of success that networks of K seeds give the plays, (K, N)."""
    seen = examples(plays, config)
    scenes = jax.device_put(scene_inputs(plays.scenes, config))
    return predict(config, params, scenes, np.asarray(plays.game), seen.plans)


def sampled(plays: Dataset) -> Dataset:
    """At most SAMPLE plays, always the same ones."""
    if len(plays) <= SAMPLE:
        return plays
    return plays.select(np.sort(np.random.default_rng(0).permutation(len(plays))[:SAMPLE]))


def measured(plays: Dataset, chances: npt.NDArray[np.float64], rates: npt.NDArray[np.float64] | None) -> dict[str, Any]:
    """Measures of judgements (K, N) of plays as JSON values: one list entry a seed.

    Args:
        plays: what was judged.
        chances: judged chances of success.
        rates: (S,) shares of random plans that solve each scene; None if they are not known.
    """
    game, label = np.asarray(plays.game), np.asarray(plays.success)
    each = [metrics.scores(game, label, one)._asdict() for one in chances]
    content: dict[str, Any] = {name: [score[name] for score in each] for name in metrics.Scores._fields}
    content["plans"] = len(game)
    bins = [metrics.reliability(label, one) for one in chances]
    content["reliability"] = {
        "plans": np.sum([one.plans for one in bins], axis=0).tolist(),
        "chance": _nan_mean([one.chance for one in bins]),
        "solved": _nan_mean([one.solved for one in bins]),
    }
    if len(plays.scenes) < GREAT:
        by_game = np.mean([metrics.accuracy_by_game(game, label, one, len(plays.scenes)) for one in chances], axis=0)
        content["games"] = {
            scene.name: float(value) for scene, value in zip(plays.scenes, by_game, strict=True) if not np.isnan(value)
        }
        content["interval over games"] = list(metrics.games_interval(by_game))
    if rates is not None:
        learned_rate = float(np.mean(rates[:10]))  # of the basic games, which stand first
        found = [metrics.natural_accuracy(game, label, metrics.at_rate(one, learned_rate), rates) for one in chances]
        content["natural"], content["natural constant"] = [one[0] for one in found], found[0][1]
    return content


def _nan_mean(rows: list[npt.NDArray[np.float64]]) -> list[float | None]:
    table = np.asarray(rows)
    counts = np.isfinite(table).sum(axis=0)
    sums = np.nansum(table, axis=0)
    return [float(total / count) if count else None for total, count in zip(sums, counts, strict=True)]


@default_options()
def evaluate(
    folder: Path,
    config: OutcomeConfig,
    state: OutcomeState,
    columns: Mapping[str, Dataset],
    rates: npt.NDArray[np.float64],
) -> dict[str, Any]:
    """Measure the networks of a run on the plays of each column and write evaluation.json."""
    params = chosen(config, state)
    found = {}
    for name, plays in columns.items():
        if len(plays):
            part = sampled(plays)
            own = rates if len(part.scenes) == len(rates) else None
            found[name] = measured(part, judge(config, params, part), own)
    content = {
        "schema": storage.RUNS.schema,
        "version": VERSION,
        "row": config.name,
        "settings": config.to_json(),
        "parameters": parameter_count(params),
        "best epochs": np.asarray(state.best_epoch).tolist() if config.keep_best else None,
        "columns": found,
        **provenance(),
    }
    replace_json(folder / EVALUATION, content)
    return content


def best_seed(evaluation: Mapping[str, Any]) -> int:
    """The seed that ships: by held-out plays of basic and unseen basic games, no others."""
    scores = [np.array(evaluation["columns"][name]["accuracy"]) for name in ("held-out basic", "unseen_basic")]
    return int(np.argmax(np.mean(scores, axis=0)))


def trained(
    config: OutcomeConfig, state: OutcomeState, evaluation: Mapping[str, Any], seed: int
) -> storage.OutcomeClassifier:
    """The network of a seed, rounded as it ships."""
    accuracy = {name: column["accuracy"][seed] for name, column in evaluation["columns"].items()}
    origin = {"seed": seed, "accuracy": accuracy, "trained": provenance()}
    params = storage.shipped_params(chosen(config, state), seed)
    return storage.OutcomeClassifier(config.name, dataclasses.replace(config, seeds=1), params, origin)


def shipped(best: storage.OutcomeClassifier) -> storage.OutcomeClassifier:
    """The network of the `best_seed`, which says how it was chosen."""
    reason = "mean accuracy on held-out plans of basic games and on unseen basic games"
    return dataclasses.replace(best, name=best.config.name, origin={**best.origin, "chosen by": reason})
