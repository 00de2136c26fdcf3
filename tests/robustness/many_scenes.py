"""Part of `make test-faults`: one process plays 50,000 scenes, no two alike, and grows by less than 100 MB. Minutes.

Every scene is played by `simulate_many`, in its environment and as a recording, and its observation is taken. What a
process keeps is bounded, so that memory stands still once the bounds are reached.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from record import record as record_check

import iphyre_jax
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.codec import scene_to_dict
from iphyre_jax.viewer.recording import record

GAMES = ("hole", "support")
SCENES = 50_000
CHUNK = 500  # scenes of one call
RECORDED = 5  # of each chunk; a recording is of one scene alone
GROWTH = 100e6  # bytes


def resident() -> float:
    """Bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096.0


def new_scenes(number: int) -> list[Scene]:
    """Return variations that no other number gives; those that overlap are refused, so there are fewer than CHUNK."""
    game = iphyre_jax.load_scene(GAMES[number % len(GAMES)])
    return list(iphyre_jax.vary(game, CHUNK, seed=number, shift_px=20.0, jitter_px=2.0).scenes)


def play(scenes: list[Scene]) -> None:
    """Play every scene in every way that keeps something of a scene."""
    index, plans = np.arange(len(scenes)), np.full((len(scenes), 1), 20)
    iphyre_jax.simulate_many(scenes, index, plans, fps=10)
    iphyre_jax.play_plans(scenes, index, np.full((len(scenes), 6), 0.1))
    iphyre_jax.observation_table(scenes)
    for scene in scenes[:RECORDED]:
        record(scene, [20], fps=10)


def main() -> int:
    """Play, measure, judge; 0 if memory has grown by less than GROWTH."""
    begun, contents = time.monotonic(), np.zeros(SCENES, np.int64)
    play(new_scenes(0) + new_scenes(1))  # what it compiles, and what a process needs once
    before = highest = resident()
    played, number = 0, 2
    while played < SCENES:
        scenes = new_scenes(number)[: SCENES - played]
        play(scenes)
        contents[played : played + len(scenes)] = [hash(str(scene_to_dict(scene) | {"name": ""})) for scene in scenes]
        played, number, highest = played + len(scenes), number + 1, max(highest, resident())
        if number % 10 == 0:
            print(f"{played} scenes, {(resident() - before) / 1e6:+.1f} MB", flush=True)
    distinct, fine = len(np.unique(contents)), highest - before < GROWTH
    print(f"{distinct} distinct scenes, at most {(highest - before) / 1e6:+.1f} MB over {before / 1e6:.0f}", flush=True)
    promise = f"a process that plays {SCENES:,} different scenes grows by less than {GROWTH / 1e6:.0f} MB"
    record_check("many-scenes", promise, SCENES, distinct if fine else 0, 0, time.monotonic() - begun)
    return 0 if fine and distinct == SCENES else 1


if __name__ == "__main__":
    sys.exit(main())
