"""One plan as a world model imagines it, as recordings for pictures, films and pages, and how far off it is.

A frame is 0.1 s. Frame 0 is the start; frame k > 0 is one physics step after k - 1 tenths of a second, as in `plays`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.configuration import default_options
from iphyre_jax.models.world.interface import Predict, predictor, roll, start_memory, start_rows
from iphyre_jax.models.world.plays import EVERY, FIRST, FPS, INSTANTS, STAYS, instants, removal_instants
from iphyre_jax.models.world.reports.metrics import BOUNDS
from iphyre_jax.models.world.rows import centres
from iphyre_jax.models.world.storage import WorldModel
from iphyre_jax.models.world.tables import SceneTables, scene_tables
from iphyre_jax.observations.official import LENGTH_COLUMNS
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import DECISIONS_PER_SECOND, GOAL_Y, NEVER
from iphyre_jax.scenes import Scene
from iphyre_jax.simulation import simulate
from iphyre_jax.viewer.recording import Recording

Floats = npt.NDArray[np.float64]


class RollOut(NamedTuple):
    """A plan, played and imagined."""

    real: Recording  # ten frames a second, up to the end of the play
    imagined: Recording  # up to its own end
    error: dict[str, Floats]  # (F,) px, mean over balls, in each frame of `real`: "model" and BOUNDS
    removals: tuple[float, ...]  # s, of the blocks that go before the end of the play


@default_options()
def roll_out_plan(model: WorldModel, scene: Scene, times: npt.ArrayLike) -> RollOut:
    """Play a plan and imagine it.

    Args:
        model: trained.
        scene: the scene; at most twelve objects.
        times: (S,) s of the eliminable blocks, NaN for never.

    Raises:
        ValueError: one line; the scene is too large, or a time is wrong.
    """
    plan = np.asarray(times, np.float64)
    if plan.shape != (len(scene.eliminable_blocks),):
        raise ValueError(f"times: expected {len(scene.eliminable_blocks)} of {scene.name}, got shape {plan.shape}")
    steps = plan_to_steps(plan[None], FPS, "simulate")
    played = simulate(scene, steps, fps=FPS, dtype="float64", sample_every=1)
    if played.samples is None:
        raise RuntimeError("simulate gave no samples")
    poses = np.asarray(played.samples[0], np.float64)
    real = np.concatenate([poses[:1], poses[FIRST::EVERY][:INSTANTS]])
    made = int(np.clip(-(-(int(played.steps[0]) - FIRST) // EVERY) + 1, 1, len(real) - 1))
    real = real[: made + 1]
    # A recording's plan is the last frame in which a block is there.
    last = np.where(steps[0] == NEVER, NEVER, -(-steps[0] // EVERY))
    shown = replace(_recording(scene, last, real, bool(played.success[0])), reward=float(played.reward[0]))
    removals = tuple(step / FPS for step in steps[0].tolist() if NEVER < step < int(played.steps[0]))

    gone = removal_instants([scene], np.zeros(1, np.int32), steps)
    at = instants(steps[0])
    imagined_last = np.where(at == STAYS, NEVER, at + 1)
    tables = scene_tables([scene])
    dreams = {
        name: _poses(predict, model, tables, gone, scene)
        for name, predict in {"model": predictor(model.config), **BOUNDS}.items()
    }
    balls = slice(scene.n_blocks, scene.n_objects)
    error = {
        name: np.linalg.norm(dream[: len(real), balls, :2] - real[:, balls, :2], axis=-1).mean(axis=-1)
        for name, dream in dreams.items()
    }
    low = dreams["model"][:, balls, 1].min(axis=-1) > GOAL_Y
    end = int(low.argmax()) if low.any() else len(low) - 1
    imagined = _recording(scene, imagined_last, dreams["model"][: end + 1], bool(low.any()))
    return RollOut(shown, imagined, error, removals)


def frame_seconds(frame: Any) -> Any:  # noqa: ANN401 - numbers, or one
    """The time of a frame after the first, s."""
    return (FIRST + EVERY * (frame - 1)) / FPS


def _recording(scene: Scene, plan: npt.NDArray[np.integer], poses: Floats, success: bool) -> Recording:
    return Recording.of_poses(scene, plan, poses, fps=DECISIONS_PER_SECOND, success=success)


def _poses(
    predict: Predict, model: WorldModel, tables: SceneTables, gone: npt.NDArray[np.int32], scene: Scene
) -> Floats:
    """Poses (F, N, 3), px and rad, of all objects; a removed object stays where it was."""
    first = jax.device_put(tables)
    memory, rows = start_memory(model.config, first), start_rows(first)
    later = roll(predict, model.params, memory, rows, jnp.asarray(gone), INSTANTS - 1, jnp.asarray)
    table = np.concatenate([np.asarray(rows)[None], np.asarray(later)])[:, 0, : scene.n_objects].astype(np.float64)
    start = np.asarray(tables.centre)[0, : scene.n_objects].astype(np.float64)
    there = table[..., LENGTH_COLUMNS - 1] > 0
    centre = np.where(there[..., None], centres(table), start)
    axis = (table[..., 2:4] - table[..., 0:2]) / 2
    half = np.asarray(tables.half)[0, : scene.n_objects].astype(np.float64)
    # Angle from the axis at the start to the axis now.
    cross = half[:, 0] * axis[..., 1] - half[:, 1] * axis[..., 0]
    turned = np.where(there, np.arctan2(cross, (half * axis).sum(axis=-1)), 0.0)
    spun = np.cumsum(table[..., -1], axis=0) / DECISIONS_PER_SECOND  # balls have no axis, but a spin, rad/s
    turned = np.where((half == 0).all(axis=-1), spun, turned)
    first_frame = np.concatenate([start, np.zeros((len(start), 1))], axis=-1)
    return np.concatenate([first_frame[None], np.concatenate([centre, turned[..., None]], axis=-1)])


def draw_errors(path: Path, found: RollOut, title: str) -> None:
    """Draw the error of balls over time, with the bounds, as PNG.

    Args:
        path: of the picture.
        found: a plan that was rolled out.
        title: of the picture.
    """
    from matplotlib.figure import Figure  # loads slowly, and every command imports this module

    figure = Figure(figsize=(6.4, 3.6), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    for name, values in found.error.items():
        seconds = np.maximum(frame_seconds(np.arange(len(values))), 0)
        axes.plot(seconds, np.maximum(values, 1e-2), label=name, linewidth=2 if name == "model" else 1)
    for k, second in enumerate(found.removals):
        axes.axvline(second, color="grey", linewidth=0.8, linestyle=":", label="" if k else "removals")
    axes.set(title=title, xlabel="s", ylabel="error of balls, px", yscale="log", ylim=(1e-2, 1e3))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path)
