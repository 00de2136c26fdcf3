"""Columns of the packed tables, (rows, columns, *lanes).

Loops read one row at a time, so what is read together is packed into one table. A vector takes two columns, x and y;
its constant names the first. Packed contacts have columns of their own, see `contact_rows.ContactLayout`.
"""

from typing import Final

import jax

from iphyre_jax.physics.vector import Vec

BAR_A, BAR_B, BAR_NORMAL, BAR_CENTRE, BAR_COMPENSATION = 0, 2, 4, 6, 8  # of `Shapes.bars`; the last in float32 only
BALL_CENTRE, BALL_RADIUS, BALL_COMPENSATION = 0, 2, 3  # of `Shapes.balls`; the last in float32 only

PAIR_KEY: Final = 0  # of `PairType.info`: order key, KEY_NONE for a pair that is no candidate
PAIR_FIRST_IS_A: Final = 1  # two balls or two bars: whether the first has role a
PAIR_POINT_CLASS: Final = 2  # two bars: four columns, the class of each point id

POINT_NORMAL, POINT_ARM_FIRST, POINT_ARM_SECOND, POINT_SEPARATION = 0, 2, 4, 6  # of `ContactTable.numbers`
POINT_WIDTH: Final = 7


def vec(row: jax.Array, column: int) -> Vec:
    """Return the vector that begins at a column of a row."""
    return Vec(row[column], row[column + 1])
