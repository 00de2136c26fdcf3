"""Settings of a world model, and the rows of the report."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

from iphyre_jax.checks import MAX_SEED, check_least, check_option, check_positive, check_whole, show

ModelName = Literal["objects", "mdrnn"]
DataName = Literal["100", "1000", "unlimited"]
MODELS: Final = get_args(ModelName)
DATA: Final = get_args(DataName)
MOST: Final = 1_000_000


@dataclass(frozen=True)
class WorldConfig:
    """Settings of one trained world model.

    Attributes:
        model: "objects" (ours) or "mdrnn" (the paper's, repaired).
        data: plays to learn from: 100 or 1,000 of the basic games, or new ones of variations too, chunk after chunk.
        seed: of initial weights, plays and batches.
        steps: gradient steps.
        batch_size: windows in a step.
        learning_rate: of Adam at the start; it falls to zero by half a cosine.
        unroll: steps of 0.1 s of a window in the second half of the training; in the first half one.
        width: of the hidden layers.
        latent: numbers that each pair remembers within a step.
        parts: into which a step of 0.1 s is cut; a divisor of six.
        passes: answers of each pair in a part.
        neighbours: objects that a body may touch, while training.
        noise_px: px, standard deviation of noise on places, in half of the windows.
        noise_speed: px/s, of noise on speeds.
        sequence: steps of a window, of "mdrnn" alone.
        chunk: steps between checkpoints.
    """

    model: ModelName = "objects"
    data: DataName = "unlimited"
    seed: int = 0
    steps: int = 2000
    batch_size: int = 128
    learning_rate: float = 2e-3
    unroll: int = 5
    width: int = 64
    latent: int = 8
    parts: int = 3
    passes: int = 2
    neighbours: int = 4
    noise_px: float = 2.0
    noise_speed: float = 5.0
    sequence: int = 64
    chunk: int = 100

    def check(self) -> None:
        """Refuse settings that cannot work.

        Raises:
            ValueError: one line naming the setting and what was expected.
        """
        check_option("model", self.model, MODELS)
        check_option("data", self.data, DATA)
        check_whole("seed", self.seed, 0, MAX_SEED)
        for name in ("steps", "batch_size", "unroll", "width", "latent", "passes", "sequence", "chunk"):
            check_whole(name, getattr(self, name), 1, MOST)
        check_whole("neighbours", self.neighbours, 1, 11)
        check_positive("learning_rate", self.learning_rate)
        for name in ("noise_px", "noise_speed"):
            check_least(name, getattr(self, name), 0)
        if 6 % check_whole("parts", self.parts, 1, 6):
            raise ValueError(f"parts: expected a divisor of 6 physics steps, got {show(self.parts)}")
        if self.steps % self.chunk:
            raise ValueError(f"chunk: expected a divisor of {self.steps} steps, got {show(self.chunk)}")

    @property
    def row(self) -> str:
        """Of the report: "objects-1000"."""
        return f"{self.model}-{self.steps}" if self.model == "mdrnn" else f"{self.model}-{self.data}"

    @property
    def name(self) -> str:
        """Of the run: "objects-1000-0", with the seed."""
        return f"{self.row}-{self.seed}"

    def to_json(self) -> dict[str, Any]:
        """The settings as a JSON object."""
        return dataclasses.asdict(self)
