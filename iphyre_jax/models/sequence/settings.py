"""Settings of a sequence model, and the presets: as the paper's code has it, as the paper meant it, clones, ours."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

from iphyre_jax.checks import check_flag, check_least, check_option, check_positive, check_whole, show
from iphyre_jax.data.labels import PlayProtocol
from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.scenes import MAX_ELIMINABLE

PresetName = Literal["paper-as-coded", "paper", "clone-solved", "clone-all", "ours"]
DataName = Literal["official", "large"]
ActionForm = Literal["plans", "choices", "events"]

PRESETS: Final = get_args(PresetName)
EVENTS: Final = MAX_ELIMINABLE + 1  # decisions at most: each but the last removes a block
ASKED: Final = 0.985  # return, of 1000 points, that evaluation asks for
MOST: Final = 1_000_000
RATES: Final = (10, 60)


@dataclass(frozen=True)
class SequenceConfig:
    """Settings of one row: models of several seeds, trained on the same plays.

    Attributes:
        preset: where the settings come from.
        strategy: "in-advance", "on-the-fly" or "combined".
        data: "official", 50 solved and 50 failed plans of each basic game; "large", thousands, and variations.
        fps: physics steps a second, of the plays and of the evaluation.
        seeds: models, with seeds 0, 1, ...
        updates: steps of the optimiser.
        batch_size: sequences in a step.
        learning_rate: of AdamW after a warm-up; it falls to `final_rate` as a cosine.
        final_rate: least learning rate.
        warm_up: steps of the warm-up.
        weight_decay: of AdamW.
        layers: of the transformer.
        width: numbers of a token.
        heads: of attention.
        context: decisions that are seen at once.
        smoothing: s, by which a learned time is blurred; 0 for not at all.
        solved_share: of the plays drawn, how many solve; 0: all plays alike, 1: nothing else. With "large" data this
            holds before the basic games and their variations get one half each, which moves it a little.
        returns: whether the return is seen; without it the model is a clone.
        coded_labels: returns, times and states as the official code computes them.
        mirrored: mirror sequences, each with a probability of one half.
        chunk: steps between checkpoints.
    """

    preset: PresetName = "paper"
    strategy: StrategyName = "in-advance"
    data: DataName = "official"
    fps: int = 60
    seeds: int = 5
    updates: int = 400
    batch_size: int = 128
    learning_rate: float = 1e-3
    final_rate: float = 1e-6
    warm_up: int = 20
    weight_decay: float = 1e-4
    layers: int = 3
    width: int = 128
    heads: int = 4
    context: int = 1
    smoothing: float = 0.2
    solved_share: float = 0.0
    returns: bool = True
    coded_labels: bool = False
    mirrored: bool = False
    chunk: int = 50

    def check(self) -> None:
        """Refuse settings that cannot work.

        Raises:
            ValueError: one line naming the setting and what was expected.
        """
        options = {"preset": PRESETS, "strategy": get_args(StrategyName), "data": get_args(DataName)}
        for name, choices in options.items():
            check_option(name, getattr(self, name), choices)
        if self.fps not in RATES:
            raise ValueError(f"fps: expected one of {RATES[0]}, {RATES[1]}, got {show(self.fps)}")
        for name in ("seeds", "updates", "batch_size", "layers", "width", "heads", "context", "chunk"):
            check_whole(name, getattr(self, name), 1, MOST)
        check_whole("warm_up", self.warm_up, 0, MOST)
        for name in ("learning_rate", "final_rate"):
            check_positive(name, getattr(self, name))
        for field in dataclasses.fields(self):
            if isinstance(field.default, bool):
                check_flag(field.name, getattr(self, field.name))
        if self.updates % self.chunk:
            raise ValueError(f"chunk: expected a divisor of {self.updates} updates, got {show(self.chunk)}")
        if self.width % self.heads:
            raise ValueError(f"heads: expected a divisor of the width {self.width}, got {show(self.heads)}")
        if self.mirrored and self.form != "events":
            raise ValueError(f"mirrored: expected False where actions are {self.form}, whose places stay, got True")
        if self.coded_labels and self.form == "events":
            raise ValueError("coded_labels: expected False where actions are events, which have none, got True")
        check_least("solved_share", self.solved_share, 0, 1)
        for name in ("smoothing", "weight_decay"):
            check_least(name, getattr(self, name), 0)

    @property
    def form(self) -> ActionForm:
        """What an action is: the times of all slots, one of seven choices, or the next removal."""
        if self.preset == "ours":
            return "events"
        return "choices" if self.strategy == "on-the-fly" else "plans"

    @property
    def name(self) -> str:
        """Of the row: "paper-in-advance"."""
        return f"{self.preset}-{self.strategy}" + ("-large" if self.data == "large" else "")

    @property
    def protocol(self) -> PlayProtocol:
        """How plays are made and models evaluated: data and evaluation share rate, rule and reset."""
        return PlayProtocol.at(self.fps)

    def to_json(self) -> dict[str, Any]:
        """The settings as a JSON object."""
        return dataclasses.asdict(self)


def settings(preset: PresetName = "paper", strategy: StrategyName = "in-advance") -> SequenceConfig:
    """The settings of a preset under a strategy, on the official plays.

    Raises:
        ValueError: one line; there is no such preset or strategy.
    """
    check_option("preset", preset, PRESETS)
    check_option("strategy", strategy, get_args(StrategyName))
    config = SequenceConfig(preset=preset, strategy=strategy, coded_labels=preset == "paper-as-coded")
    if preset in ("clone-solved", "clone-all"):
        config = dataclasses.replace(config, returns=False, solved_share=float(preset == "clone-solved"))
    if preset == "ours":
        return dataclasses.replace(config, context=EVENTS, updates=300, batch_size=128, mirrored=True, solved_share=0.6)
    if strategy == "combined":
        return dataclasses.replace(config, context=EVENTS, updates=200, batch_size=64)
    if strategy == "on-the-fly":
        return dataclasses.replace(config, context=20, updates=200, batch_size=32, fps=OFFICIAL_FPS)
    return config
