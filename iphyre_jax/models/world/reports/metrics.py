"""What a world model is worth: errors by horizon beside bounds, calibration, imagined outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.models.world.imagine import MOVERS, TIES, roll_out
from iphyre_jax.models.world.interface import (
    NEIGHBOURS,
    Predict,
    falls_until_contact,
    memory_after,
    moves_on,
    nothing_moves,
    predictor,
    roll,
    start_memory,
)
from iphyre_jax.models.world.networks import objects
from iphyre_jax.models.world.plays import MOVING, official_plays
from iphyre_jax.models.world.rows import rows_of
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.storage import WorldModel
from iphyre_jax.models.world.tables import Plays, SceneTables, State, state_of
from iphyre_jax.models.world.training import taken
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import SPLITS

HORIZONS: Final = (1, 5, 10, 30, 60)  # steps of 0.1 s
WINDOWS: Final = 300  # of a split
PLAYS: Final = 10  # of each game
HELD: Final = "basic"  # games that were learned from, with other plans
COLUMNS: Final = (HELD, "unseen_basic", "noisy", "compositional", "multi_ball")
BOUNDS: Final[Mapping[str, Predict]] = {"nothing moves": nothing_moves, "free fall until contact": falls_until_contact}
ERROR_BOUNDS: Final = {**BOUNDS, "moves on as in the last 0.1 s": moves_on}  # which tells nothing of a start at rest
SEED: Final = 1  # of the judged plans
COUNTED: Final = 100  # other plays of each game, whose more frequent outcome is a bound
CERTAIN: Final = 0.01  # px, sigma of a place that is as good as certain

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]


@lru_cache(8)
def judged_plays(split: str, each: int = PLAYS) -> Plays:
    """Plays of a split that no run learns from."""
    return official_plays(SPLITS[split], each, SEED, MOVERS, TIES)


def _balls(plays: Plays) -> npt.NDArray[np.bool_]:
    """(S, M) which moving bodies are balls."""
    ball = np.take_along_axis(np.asarray(plays.scenes.ball), np.asarray(plays.scenes.mover), axis=1)
    return np.asarray(ball & np.asarray(plays.scenes.moves))


def _judged(plays: Plays) -> npt.NDArray[np.bool_]:
    """(N, T, M) balls that move, within the picture."""
    state = np.asarray(plays.state)
    moves = np.linalg.norm(state[..., 3:5], axis=-1) > MOVING
    seen = ((state[..., :2] >= 0) & (state[..., :2] <= SCREEN)).all(axis=-1)
    return np.asarray(moves & seen & _balls(plays)[np.asarray(plays.scene)][:, None])


def moving_windows(plays: Plays) -> Integers:
    """Beginnings (W, 2), play and instant, at which a ball moves within the picture; always the same ones."""
    state, moving = np.asarray(plays.state), _judged(plays).any(axis=-1)
    found = np.argwhere(moving & (np.arange(state.shape[1]) + 1 < np.asarray(plays.valid)[:, None]))
    chosen = np.random.default_rng(0).permutation(len(found))[:WINDOWS]
    return found[np.sort(chosen)].astype(np.int32)


def horizon_errors(predict: Predict, params: Any, config: WorldConfig | None, plays: Plays, index: Integers) -> Floats:  # noqa: ANN401
    """Distances (horizons, W, M), px, between predicted and real balls that move in the picture at first.

    NaN for other bodies and after the end. A model that remembers has seen half a window of its training before, a
    bound the last 0.1 s.

    Args:
        predict: of a model or a bound.
        params: its parameters.
        config: its settings; None for a bound.
        plays: that really happened.
        index: (W, 2) play and instant at which each prediction begins.
    """
    number, instant = index[:, 0], index[:, 1]
    scene: SceneTables = jax.tree.map(jnp.asarray, taken(plays.scenes, jnp.asarray(plays.scene)[number]))
    recorded = np.asarray(plays.state)
    state = State(*map(jnp.asarray, state_of(recorded[number, instant])))
    removed = np.asarray(plays.gone)[number]
    seen = (jnp.asarray(recorded[number]), jnp.asarray(removed), jnp.asarray(instant))
    steps = 1 if config is None else config.sequence // 2
    memory = memory_after(predict, params, start_memory(config, scene), *seen, steps)
    gone = removed - instant[:, None]
    rows = rows_of(scene, state, jnp.asarray(gone >= 0))
    centre = np.asarray(roll(predict, params, memory, rows, jnp.asarray(gone), max(HORIZONS)))
    mover = np.asarray(scene.mover)
    errors, judged = np.full((len(HORIZONS), *mover.shape), np.nan), _judged(plays)[number, instant]
    for k, horizon in enumerate(HORIZONS):
        there = np.take_along_axis(centre[horizon - 1], mover[..., None], axis=1)
        later = np.minimum(instant + horizon, recorded.shape[1] - 1)
        error = np.linalg.norm(there - recorded[number, later][..., :2], axis=-1)
        counted = (instant + horizon < np.asarray(plays.valid)[number])[:, None] & judged
        errors[k] = np.where(counted, error, np.nan)
    return errors


@partial(jax.jit, static_argnums=0)
def _one_step(config: WorldConfig, params: Any, scene: SceneTables, state: State, alive: jax.Array) -> Any:  # noqa: ANN401
    return objects.step(config, params, scene, state, alive, NEIGHBOURS)


def calibration(model: WorldModel, plays: Plays, index: Integers) -> dict[str, float]:
    """Shares of the true places of balls after 0.1 s within one and two sigma; right would be 68 % within one.

    Places that are as good as certain, those of balls that fall freely, are left out; "uncertain" is what is left.
    """
    number, instant = index[:, 0], index[:, 1]
    scene = taken(plays.scenes, jnp.asarray(plays.scene)[number])
    recorded = np.asarray(plays.state)
    state = State(*map(jnp.asarray, state_of(recorded[number, instant])))
    alive = jnp.asarray(np.asarray(plays.gone)[number] > instant[:, None])
    mean, sigma = _one_step(model.config, model.params, scene, state, alive)
    error = np.abs(np.asarray(mean.centre) - recorded[number, instant + 1][..., :2])
    spread = np.asarray(sigma.centre)
    ball = _balls(plays)[plays.scene[number]]
    counted = ball & (spread > CERTAIN)
    shares = {f"{name} sigma": (error[counted] < k * spread[counted, None]) for k, name in ((1, "one"), (2, "two"))}
    found = {name: float(share.mean()) for name, share in shares.items() if share.size}
    return {**found, "uncertain": float(counted.sum() / ball.sum())}


def outcomes(predict: Predict, model: WorldModel, plays: Plays) -> dict[str, float]:
    """Share of plans whose outcome is imagined rightly, of all and of each outcome."""
    found = roll_out(predict, model, plays.scenes, np.asarray(plays.scene), np.asarray(plays.gone)).success
    real = np.asarray(plays.success)
    return {
        "right": float((found == real).mean()),
        "right if solved": float(found[real].mean()) if real.any() else float("nan"),
        "right if not": float((~found[~real]).mean()) if not real.all() else float("nan"),
    }


def median_errors(errors: Floats) -> list[float]:
    """The median of `horizon_errors` at each horizon, px."""
    return [float(np.nanmedian(row)) for row in errors]


def error_bounds(folder: Path) -> Row:
    """Median errors of ERROR_BOUNDS at each horizon, px, by split and name, of the moments by which models are judged.

    The row is kept in a file of the folder; errors as `kept_row`.
    """
    settings = {"plays": PLAYS, "seed": SEED, "windows": WINDOWS, "horizons": list(HORIZONS)}
    return kept_row(folder, "errors", settings, lambda: {split: _bounded(split) for split in COLUMNS})


def _bounded(split: str) -> dict[str, list[float]]:
    plays = judged_plays(split)
    index = moving_windows(plays)
    return {name: median_errors(horizon_errors(bound, (), None, plays, index)) for name, bound in ERROR_BOUNDS.items()}


def frequent_outcomes(folder: Path) -> Row:
    """What always saying how most of COUNTED other plays of a game end is worth: the share that is right, by split.

    The row is kept in a file of the folder; errors as `kept_row`.
    """
    settings = {"plays": PLAYS, "seed": SEED, "other plays": COUNTED, "their seed": SEED + 1}
    return kept_row(folder, "more-frequent-outcome", settings, lambda: {split: _frequent(split) for split in COLUMNS})


def _frequent(split: str) -> float:
    plays, others = judged_plays(split), official_plays(SPLITS[split], COUNTED, SEED + 1, MOVERS, TIES)
    solved, game = np.asarray(others.success), np.asarray(others.scene)
    frequent = np.array([solved[game == k].mean() > 0.5 for k in range(len(SPLITS[split]))])
    return float((frequent[np.asarray(plays.scene)] == np.asarray(plays.success)).mean())


def measured(model: WorldModel, split: str) -> dict[str, Any]:
    """All measures of a model on a split, as JSON values."""
    plays, predict = judged_plays(split), predictor(model.config)
    index = moving_windows(plays)
    errors = horizon_errors(predict, model.params, model.config, plays, index)
    content: dict[str, Any] = {
        "plays": len(plays.scene),
        "windows": len(index),
        "median error px": {"model": median_errors(errors)},
        "one step, 90 %": float(np.nanquantile(errors[0], 0.9)),
        "outcomes": outcomes(predict, model, plays),
    }
    if model.config.model == "objects":
        content["calibration"] = calibration(model, plays, index)
    return content
