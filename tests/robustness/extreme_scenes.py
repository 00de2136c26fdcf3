"""Extreme scenes: poses stay finite or the world says that it is at fault, and its neighbours keep every bit.

Each topology is played in one batch, at 10 and 60 steps a second, in both number types. A calm scene stands at both
ends of the batch; it must end as it does alone. `python -m tests.robustness.extreme_scenes` plays all topologies.
The programs of a pile take long to compile, in time that grows with the square of its balls and faster.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence

import numpy as np

from iphyre_jax import Scene, simulate, simulate_many
from iphyre_jax.scenes.limits import MAX_COORDINATE, MIN_LENGTH, Limits
from tests.robustness.record import record

RATES, DTYPES = (10, 60), ("float32", "float64")
SECONDS, SAMPLES = 6.0, 6
PILE = 8  # balls; a program for 8 takes half a minute of a core, for 12 a minute and a half, and a pile needs eight
CALM = "calm"

Bar = tuple[tuple[float, float], tuple[float, float]]
Ball = tuple[float, float, float]
FAR, NEAR = MAX_COORDINATE, 1.001 * MIN_LENGTH  # a difference of coordinates must not be rounded below the limit
FLOOR: Bar = ((100, 500), (500, 500))
LOG: Bar = ((250, 300), (350, 300))  # a bar that moves
BALLS: tuple[Ball, Ball] = ((200, 100, 20), (400, 100, 20))


def _scene(name: str, static: Sequence[Bar], moving: Sequence[Bar], balls: Sequence[Ball]) -> Scene:
    """Return a scene whose first static bar can be removed."""
    movers = len(moving) + len(balls)
    return Scene(
        name=name,
        blocks=[*static, *moving],  # type: ignore[arg-type]  # lists become arrays
        balls=list(balls),  # type: ignore[arg-type]
        eliminable=np.arange(len(static) + movers) == 0,
        dynamic=np.arange(len(static) + movers) >= len(static),
        limits=Limits(objects=30),
    )


def pairs() -> list[Scene]:
    """Return scenes of a moving bar and two balls."""
    scenes = {
        CALM: ((FLOOR,), LOG, BALLS),
        "balls in one place": ((FLOOR,), LOG, ((300, 100, 20), (300, 100, 20))),
        "a ball within a ball": ((FLOOR,), LOG, ((300, 100, 90), (300, 100, 20))),
        "bars in one place": ((LOG, FLOOR), LOG, BALLS),
        "bars in one place, turned": ((LOG[::-1], FLOOR), LOG, BALLS),
        "ten bars in one place": ((FLOOR,) * 10, ((100, 500), (500, 500)), BALLS),
        "ten bars through one point": (_star(300, 300), LOG, BALLS),
        "shortest bars": ((((300, 300), (300 + NEAR, 300)),), ((300, 300), (300, 300 + NEAR)), BALLS),
        "a shortest bar in a ball": ((FLOOR,), ((300, 100), (300 + NEAR, 100)), ((300, 100, 20), (400, 100, 20))),
        "smallest balls": ((FLOOR,), LOG, ((300, 290, NEAR), (300, 290, NEAR))),
        "a smallest ball on an axis": ((FLOOR,), LOG, ((300, 500, NEAR), (300, 300, NEAR))),
        "largest balls": ((FLOOR,), LOG, ((300, 100, FAR), (301, 100, FAR))),
        "largest balls in one place": ((FLOOR,), LOG, ((300, 100, FAR), (300, 100, FAR))),
        "the largest and the smallest": ((FLOOR,), LOG, ((300, 100, FAR), (300, 100, NEAR))),
        "longest bars": ((((-FAR, FAR), (FAR, -FAR)),), ((-FAR, -FAR), (FAR, FAR)), BALLS),
        "corners": ((((-FAR, -FAR), (-FAR, FAR)),), ((FAR, -FAR), (FAR, FAR)), ((-FAR, -FAR, 20), (FAR, -FAR, 20))),
        "all at a corner": ((((-FAR, -FAR), (0, 0)),), ((-FAR, -FAR), (0, 0)), ((-FAR, -FAR, 20),) * 2),
        "balls at the ends of bars": ((FLOOR,), LOG, ((100, 500, 20), (250, 300, 20))),
        "balls that just touch": ((FLOOR,), LOG, ((300, 250, 20), (300, 210, 20))),
    }
    return [_scene(name, static, [moving], balls) for name, (static, moving, balls) in scenes.items()]


def piles(size: int) -> list[Scene]:
    """Return scenes of so many balls, up to 15, the most bodies that may move."""
    grid = [(60 + 120 * (k % 5), 60 + 120 * (k // 5)) for k in range(size)]
    balls: Mapping[str, list[Ball]] = {
        CALM: [(x, y, 20) for x, y in grid],
        "balls in one place": [(300, 300, 20)] * size,
        "balls in nearly one place": [(300 + NEAR * k, 300, 20) for k in range(size)],
        "a tower": [(300, 480 - 40 * k, 20) for k in range(size)],
        "a pile": [(x / 5 + 250, y / 5 + 300, 30) for x, y in grid],
        "largest balls": [(x, y, FAR) for x, y in grid],
        "smallest balls": [(300 + NEAR * k, 480, NEAR) for k in range(size)],
        "balls at a corner": [(-FAR, -FAR, 20)] * size,
        "balls within balls": [(300, 300, 10.0 * (k + 1)) for k in range(size)],
    }
    return [_scene(f"{name}, {size}" if name != CALM else CALM, (FLOOR,), (), of) for name, of in balls.items()]


def _star(x: float, y: float) -> tuple[Bar, ...]:
    angles = np.arange(10) * np.pi / 10
    arms = 80 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return tuple(((x - a, y - b), (x + a, y + b)) for a, b in arms.tolist())


def complaints(scenes: Sequence[Scene], dtype: str, fps: int) -> list[str]:
    """Play scenes of one topology, the first of them calm, in one batch; return a line for each broken promise."""
    steps = int(SECONDS * fps)
    options = {"fps": fps, "duration": SECONDS, "dtype": dtype, "sample_every": steps // SAMPLES}
    batch, plan = [*scenes, scenes[0]], [[-1], *[[steps // 3]] * (len(scenes) - 1), [-1]]
    played = simulate_many(batch, np.arange(len(batch)), plan, **options)  # type: ignore[arg-type]
    alone = simulate(scenes[0], plan[:1], **options)  # type: ignore[arg-type]
    assert played.samples is not None
    assert alone.samples is not None
    found = []
    for k, scene in enumerate(batch):
        where = f"{scene.name}, {dtype}, {fps} fps"
        moving = played.samples[k, :, np.flatnonzero(scene.dynamic)]
        if not np.isfinite(moving).all() and not played.fault[k]:
            found.append(f"{where}: poses are not finite, and no fault says so")
        if played.fault[k] and played.success[k]:
            found.append(f"{where}: solved in spite of a fault")
        if scene.name == CALM:
            same = np.array_equal(played.samples[k, :, : scene.n_objects], alone.samples[0], equal_nan=True)
            if not same or played.reward[k] != alone.reward[0] or played.fault[k]:
                found.append(f"{where}: its neighbours changed it")
    return found


def main() -> int:
    """Play all; return 1 if a promise was broken."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--pile", type=int, default=PILE, help="balls of a pile, up to 15")
    size = parser.parse_args().pile
    begun, found, tried = time.monotonic(), [], 0
    for scenes in (pairs(), piles(size)):
        for dtype in DTYPES:
            for fps in RATES:
                found += complaints(scenes, dtype, fps)
                tried += len(scenes)
                print(f"{tried} worlds, {len(found)} complaints", flush=True)
    for line in found:
        print(line, flush=True)
    promise = "a world of extreme geometry stays finite or says that it is at fault, its neighbours keep every bit"
    broken = min(tried, len(found))
    record("extreme-scenes", promise, tried, tried - broken, broken, time.monotonic() - begun)
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
