"""Film one plan in both engines: `python -m parity.reports.film hole --plan - - 1.38 0.54 -o hole.mp4`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import iphyre_jax
from iphyre_jax.plans import parse_plan, plan_to_steps
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.viewer.films import save
from iphyre_jax.viewer.frames import Look
from iphyre_jax.viewer.recording import Recording, record
from parity.engines.reference import VERSION, run


def play_both(
    scene: iphyre_jax.Scene, plan: list[int], fps: int, dtype: str, resets: int
) -> tuple[Recording, Recording]:
    """Record a plan in our engine and in the reference."""
    ours = record(scene, plan, fps=fps, dtype=dtype, resets=resets)
    theirs = run(scene, np.array(plan), fps=fps, steps=int(TIME_LIMIT * fps), resets=resets)
    samples = theirs.samples[: theirs.steps + 1]
    return ours, Recording.of_poses(scene, plan, samples, fps=fps, success=theirs.success)


def main() -> int:
    """Write the film; return 0, or 2 for bad options."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", help="a game's name or a scene file")
    parser.add_argument("--plan", nargs="*", default=[], help="seconds, - for never")
    parser.add_argument("--fps", type=int, default=60)
    parser.add_argument("--dtype", choices=("float64", "float32"), default="float32")
    parser.add_argument("--resets", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path, default=Path("both.mp4"))
    options = parser.parse_args()
    try:
        _write(options)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _write(options: argparse.Namespace) -> None:
    scene = iphyre_jax.load_scene(options.scene)
    plan = plan_to_steps(parse_plan(options.plan, scene), options.fps, "simulate")[0].tolist()
    plays = play_both(scene, plan, options.fps, options.dtype, options.resets)
    save(options.out, plays, Look(trails=True), [f"ours, {options.dtype}", f"pymunk {VERSION}"])
    steps = min(len(play.poses) for play in plays)
    apart = np.abs(plays[0].poses[:steps, :, :2] - plays[1].poses[:steps, :, :2]).max()
    print(f"{options.out}: {plays[0].steps} and {plays[1].steps} steps, at most {apart:.2g} px apart")


if __name__ == "__main__":
    sys.exit(main())
