"""Numbers of the reference solver, each with its unit and where it comes from.

The reference writes several of them as float32 literals and stores them in doubles; the digits below are what the
doubles really hold, and a "rounder" value breaks parity.
"""

from typing import Final

GRAVITY: Final = 100.0  # px/s^2, y points down
BAR_RADIUS: Final = 10.0  # px, half the thickness of every bar
MASS: Final = 1.0  # every moving body
BAR_MOMENT: Final = (20.0 * 20.0 + 4.0 * 10.0 * 10.0) / 12.0
"""Moment of a moving bar, whatever its length: the benchmark asks for the moment of a zero-length segment of radius
10, that is of a 20 x 20 box (66.67)."""
RESTITUTION: Final = 0.1 * 0.1  # pair value: the product of two shapes' 0.1 (0.010000000000000002)
FRICTION: Final = 0.5 * 0.5  # pair value: the product of two shapes' 0.5

SLOP: Final = 0.10000000149011612  # px of overlap left alone: float32 0.1 stored in a double
BIAS_BASE: Final = 0.0017970074436457143  # float32 0.9 to the 60th power: overlap left after one second
FAT_MARGIN: Final = 0.10000000149011612  # growth of a fat box, in box sizes and in seconds of motion: float32 0.1
SWEEPS: Final = 10  # solver iterations a step
PERSISTENCE: Final = 3  # steps for which the impulses of a lost contact are remembered

SPRING_REST: Final = 20.0  # px
SPRING_STIFFNESS: Final = 1.0
SPRING_DAMPING: Final = 0.3  # 1/s


HASH_COEFFICIENT: Final = 3344921057  # multiplier of the reference's pair hash, modulo 2^64
LEAF_TABLE_SIZES: Final = (5, 13, 23, 47, 97)  # buckets of the table that holds the moving shapes, as it grows
