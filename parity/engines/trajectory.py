"""One play of the reference, which may come from pymunk or from a golden file."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One play of a scene in the reference.

    Attributes:
        success: whether every ball was below the goal line after the last step.
        steps: physics steps made, the solving one included.
        eliminations: blocks removed by then.
        samples: (K, N, 3) float64 x, y (px) and angle (rad) of every object at the start and after every
            `sample_every` steps; NaN once an object is gone, the last pose repeated once the play is over.
    """

    success: bool
    steps: int
    eliminations: int
    samples: NDArray[np.float64]
