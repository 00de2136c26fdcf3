"""Seeded variations of a scene: mirrored, shifted, scaled, jittered, with extra blocks.

The operations are pure functions of B layouts and B parameters. `vary` draws the parameters and refuses invalid
results, with a reason: an object sticks out of the picture, or two objects overlap more than in the original.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_SEED, check_flag, check_least, check_whole, show
from iphyre_jax.memory import check_memory
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes.geometry import TOLERANCE, Floats, Layouts, gaps, outside
from iphyre_jax.scenes.limits import MAX_COORDINATE, MAX_NAME, MIN_LENGTH
from iphyre_jax.scenes.scene import Scene, check_is_scene

VALID: Final = ""
_MOST: Final = 1_000_000  # variations in a call
_MOST_STRETCH: Final = 100.0
_BYTES_OF_PAIR: Final = 150  # of the numbers that lead to the gap of two objects; measured: at most 140
_BYTES_OF_SCENE: Final = 10_000  # of a Scene and its arrays
_EXTRA_LENGTH: Final = (20.0, 120.0)  # px, of an added block's axis


def mirror(layouts: Layouts, which: npt.NDArray[np.bool_]) -> Layouts:
    """Mirror left and right those layouts for which `which`, (B,) bool, is True."""
    bars, balls = layouts.bars.copy(), layouts.balls.copy()
    bars[which, ..., 0] = SCREEN - bars[which, ..., 0]
    balls[which, :, 0] = SCREEN - balls[which, :, 0]
    return Layouts(bars, balls)


def shift(layouts: Layouts, by: Floats) -> Layouts:
    """Move all objects by (B, 2) px."""
    balls = layouts.balls.copy()
    balls[..., :2] += by[:, None]
    return Layouts(layouts.bars + by[:, None, None], balls)


def scale(layouts: Layouts, by: Floats) -> Layouts:
    """Stretch all positions about the centre of the picture by factors (B,). Radii stay: that of bars is fixed."""
    balls, half = layouts.balls.copy(), SCREEN / 2
    balls[..., :2] = half + (balls[..., :2] - half) * by[:, None, None]
    return Layouts(half + (layouts.bars - half) * by[:, None, None, None], balls)


def jitter(layouts: Layouts, blocks: Floats, balls: Floats) -> Layouts:
    """Move each block by (B, n, 2) px and each ball by (B, m, 2) px."""
    moved = layouts.balls.copy()
    moved[..., :2] += balls
    return Layouts(layouts.bars + blocks[:, :, None], moved)


def add_blocks(layouts: Layouts, blocks: Floats) -> Layouts:
    """Append blocks, (B, k, 2, 2) px."""
    return Layouts(np.concatenate([layouts.bars, blocks], axis=1), layouts.balls)


def refusal_reasons(layouts: Layouts, allowed: Floats) -> list[str]:
    """Return for each layout why it is refused, or "" if it is valid.

    Args:
        layouts: B layouts of N objects.
        allowed: (N, N) px, the overlaps of the original as negative gaps; 0 elsewhere.
    """
    far, between = outside(layouts), gaps(layouts)
    finite = np.asarray(np.isfinite(layouts.ends()).all(axis=(1, 2, 3)))
    worse = np.triu(between < allowed[None] - TOLERANCE, k=1)
    bars = layouts.bars.shape[1]

    def name(index: int) -> str:
        return f"block {index}" if index < bars else f"ball {index - bars}"

    reasons = []
    for b in range(len(far)):
        if not finite[b]:
            reasons.append("a coordinate is not finite")
        elif (far[b] > TOLERANCE).any():
            index = int(far[b].argmax())
            reasons.append(f"{name(index)} sticks out of the picture by {far[b, index]:.3g} px")
        elif worse[b].any():
            i, j = np.argwhere(worse[b])[0].tolist()
            reasons.append(f"{name(i)} and {name(j)} overlap by {-between[b, i, j]:.3g} px")
        else:
            reasons.append(VALID)
    return reasons


@dataclass(frozen=True, eq=False)
class Variations:
    """The result of `vary`.

    Attributes:
        scenes: the valid variations, in the order drawn.
        refused: the reason for each refused variation, in the order drawn.
    """

    scenes: tuple[Scene, ...]
    refused: tuple[str, ...]


def vary(
    scene: Scene,
    count: int,
    *,
    seed: int = 0,
    mirrored: bool = True,
    shift_px: float = 0.0,
    scale_by: float = 1.0,
    jitter_px: float = 0.0,
    extra_blocks: int = 0,
) -> Variations:
    """Draw variations of a scene. The same seed gives the same variations.

    Variations keep the topology of the scene (`iphyre_jax.physics.types.Topology`), so that they run in the same
    compiled program. Only extra blocks may change it, if they need more room.

    Args:
        scene: the original.
        count: how many to draw, 1 to 1,000,000, if memory allows; refused ones are not replaced.
        seed: of the random numbers, 0 to 2**63 - 1.
        mirrored: mirror each variation with a probability of one half.
        shift_px: px, the largest shift of the whole scene in each direction, 0 to 10,000.
        scale_by: positions are stretched by a factor from 1 / scale_by to scale_by; 1 to 100.
        jitter_px: px, the largest shift of each block and ball on its own in each direction, 0 to 10,000.
        extra_blocks: how many static blocks to add at random places; they cannot be removed.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    _check_arguments(scene, count, seed, shift_px, scale_by, jitter_px, extra_blocks)
    check_flag("mirrored", mirrored)
    rng = np.random.default_rng(seed)
    chance = rng.random(count) < 0.5
    layouts = mirror(Layouts.of(scene, count), chance & mirrored)
    factors = np.exp(rng.uniform(-1, 1, count) * math.log(scale_by))
    layouts = scale(layouts, factors)
    layouts = shift(layouts, rng.uniform(-shift_px, shift_px, (count, 2)))
    moves = rng.uniform(-jitter_px, jitter_px, (count, scene.n_objects, 2))
    layouts = jitter(layouts, moves[:, : scene.n_blocks], moves[:, scene.n_blocks :])
    layouts = add_blocks(layouts, _random_blocks(rng, count, extra_blocks))
    original = np.minimum(gaps(Layouts.of(scene))[0], 0.0)
    allowed = _pad_overlaps(original, scene.n_blocks, extra_blocks)
    reasons = refusal_reasons(layouts, allowed)
    taken = tuple(
        _varied_scene(scene, f"~{seed}.{b}", layouts.bars[b], layouts.balls[b])
        for b, reason in enumerate(reasons)
        if reason == VALID
    )
    return Variations(taken, tuple(reason for reason in reasons if reason != VALID))


def _check_arguments(
    scene: Scene, count: int, seed: int, shift_px: float, scale_by: float, jitter_px: float, extra_blocks: int
) -> None:
    check_is_scene("scene", scene)
    check_whole("count", count, 1, _MOST)
    check_whole("seed", seed, 0, MAX_SEED)
    check_whole("extra_blocks", extra_blocks, 0)
    for name, number in (("shift_px", shift_px), ("jitter_px", jitter_px)):
        check_least(name, number, 0, MAX_COORDINATE)
    check_least("scale_by", scale_by, 1, _MOST_STRETCH)
    if extra_blocks > (most := scene.limits.objects - scene.n_objects):
        raise ValueError(f"extra_blocks: expected at most {most} for {scene.name}, got {show(extra_blocks)}")
    pairs = (scene.n_objects + extra_blocks) ** 2  # their gaps are worked out for all variations at once
    check_memory("count", count * (_BYTES_OF_PAIR * pairs + _BYTES_OF_SCENE), "draw fewer at a time, with other seeds")


def _random_blocks(rng: np.random.Generator, count: int, blocks: int) -> Floats:
    """Draw blocks, (count, blocks, 2, 2) px, with uniform centre, length and angle."""
    middle = rng.uniform(0, SCREEN, (count, blocks, 2))
    size = rng.uniform(*_EXTRA_LENGTH, (count, blocks))
    angle = rng.uniform(0, math.pi, (count, blocks))
    half = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * (np.maximum(size, MIN_LENGTH) / 2)[..., None]
    return np.stack([middle - half, middle + half], axis=2)


def _pad_overlaps(overlaps: Floats, bars: int, added: int) -> Floats:
    """Insert zeros into (N, N) overlaps for blocks that are added after the first `bars` objects."""
    rows = np.insert(overlaps, [bars] * added, 0.0, axis=0)
    return np.insert(rows, [bars] * added, 0.0, axis=1)


def _varied_scene(original: Scene, suffix: str, bars: Floats, balls: Floats) -> Scene:
    """Return a scene with the flags and pairs of the original; added blocks come after its own blocks.

    suffix: of the name, the same for no other scene; a long name of the original is cut before it.
    """
    added, own = len(bars) - original.n_blocks, original.n_blocks

    def renumbered(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((i + added * (i >= own), j + added * (j >= own)) for i, j in pairs)

    return Scene(
        name=original.name[: MAX_NAME - len(suffix)] + suffix,
        blocks=bars,
        balls=balls,
        eliminable=np.insert(original.eliminable, [own] * added, False),
        dynamic=np.insert(original.dynamic, [own] * added, False),
        joints=renumbered(original.joints),
        springs=renumbered(original.springs),
        limits=original.limits,
    )
