"""Settings of an outcome classifier, and the presets: what the paper does, the same cleaned up, and our own."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, get_args

from iphyre_jax.checks import (
    check_flag,
    check_least,
    check_option,
    check_positive,
    check_resets,
    check_whole,
    show,
    whole_fps,
)
from iphyre_jax.train.settings.agents import ATTENTION_HEADS

NetworkName = Literal["global", "object", "vision", "plan", "scene", "relations", "ranker"]
PresetName = Literal["paper", "clean", "relations", "ranker"]
DataName = Literal["official", "large", "generated", "pool"]

NETWORKS: Final = get_args(NetworkName)
PRESETS: Final = get_args(PresetName)
MAX_EPOCHS: Final = 100_000
VISION_BATCH: Final = 64


@dataclass(frozen=True)
class OutcomeConfig:
    """Settings of one row: networks of several seeds, trained side by side on the same plays.

    Attributes:
        preset: where the settings come from.
        network: "global", "object" and "vision" are the paper's; "plan" and "scene" see only one of the two inputs.
        data: "official", 50 solved and 50 failed plans of each basic game; "large", thousands, and variations;
            "generated", those and generated scenes; "pool", a file of generated scenes, and variations.
        fps: physics steps a second of the plays.
        resets: number of the reset in which they are made.
        seeds: networks, with seeds 0, 1, ...
        epochs: passes over the plays.
        batch_size: plays in a step.
        plans_per_scene: plays of a scene in a batch, of which half solve it; 1: plays are drawn one by one.
        learning_rate: of Adam at the start.
        final_rate: least learning rate.
        half_period: steps from the largest rate to the least, after which it rises again; 0: once over all steps.
        weight_decay: of AdamW.
        time_scale: s, by which times are divided.
        removal_flag: tell apart a block that stays from one that goes at once.
        masked_times: leave out removals after the end of the play, as the official files do. This tells of the outcome.
        equal_weights: count each game and class alike in the loss.
        draws: plays of an epoch, drawn so that each scene and outcome is equally frequent; 0: every play once.
        mirrored: mirror plays, each with a probability of one half.
        keep_best: keep the network of the epoch with the least loss on held-out plays of basic; else the last.
        width: features of each object, of "relations" and "ranker" alone.
        rounds: of attention, of "relations" and "ranker" alone.
        chunk: epochs between checkpoints.
        basic_share: share of the draws for the ten basic games, which stand first in the data; the others are of all
            scenes alike.
        listwise: weight of a second loss, of a scene's plans as a list, beside the cross entropy of each; 0 for none.
    """

    LATER: ClassVar = ("basic_share", "listwise")  # settings that files have only if they are not the default

    preset: PresetName = "paper"
    network: NetworkName = "global"
    data: DataName = "official"
    fps: int = 60
    resets: int = 1
    seeds: int = 5
    epochs: int = 200
    batch_size: int = 16
    plans_per_scene: int = 1
    learning_rate: float = 1e-3
    final_rate: float = 1e-6
    half_period: int = 200
    weight_decay: float = 0.0
    time_scale: float = 1.0
    removal_flag: bool = False
    masked_times: bool = True
    equal_weights: bool = False
    draws: int = 0
    mirrored: bool = False
    keep_best: bool = False
    width: int = 32
    rounds: int = 3
    chunk: int = 20
    basic_share: float = 0.0
    listwise: float = 0.0

    def check(self) -> None:
        """Refuse settings that cannot work.

        Raises:
            ValueError: one line naming the setting and what was expected.
        """
        for name, options in (("preset", PRESETS), ("network", NETWORKS), ("data", get_args(DataName))):
            check_option(name, getattr(self, name), options)
        for name in ("seeds", "epochs", "batch_size", "plans_per_scene", "width", "rounds", "chunk"):
            check_whole(name, getattr(self, name), 1, MAX_EPOCHS)
        if self.network in ("relations", "ranker") and self.width < ATTENTION_HEADS:
            raise ValueError(f"width: expected at least {ATTENTION_HEADS}, the heads of attention, got {self.width}")
        for name in ("half_period", "draws"):
            check_whole(name, getattr(self, name), 0)
        for name in ("learning_rate", "final_rate", "time_scale"):
            check_positive(name, getattr(self, name))
        for field in dataclasses.fields(self):
            if isinstance(field.default, bool):
                check_flag(field.name, getattr(self, field.name))
        whole_fps(self.fps)
        check_resets(self.resets)
        if self.batch_size % self.plans_per_scene:
            expected = f"a divisor of batch_size, {self.batch_size}"
            raise ValueError(f"plans_per_scene: expected {expected}, got {show(self.plans_per_scene)}")
        check_least("listwise", self.listwise, 0)
        check_least("basic_share", self.basic_share, 0, 1)
        if self.basic_share and not (self.draws and self.data in ("large", "generated")):
            expected = "0 unless plays are drawn from large or generated data"
            raise ValueError(f"basic_share: expected {expected}, got {show(self.basic_share)}")
        if self.plans_per_scene > 1 and not self.draws:
            raise ValueError("draws: expected plays of an epoch, as plans_per_scene is above 1, got 0")
        if self.network == "vision" and self.mirrored:
            raise ValueError("mirrored: expected False with vision, whose pictures are not mirrored, got True")
        if self.network in ("relations", "ranker") and self.time_scale != 1:
            raise ValueError(f"time_scale: expected 1 with {self.network}, that sees seconds, got {self.time_scale:g}")
        if self.network != "ranker" and self.plans_per_scene > 1:
            raise ValueError(f"plans_per_scene: expected 1 unless with ranker, got {show(self.plans_per_scene)}")
        if self.epochs % self.chunk:
            raise ValueError(f"chunk: expected a divisor of {self.epochs} epochs, got {show(self.chunk)}")

    @property
    def name(self) -> str:
        """Of the row: "paper-global"; "relations", or "relations-basic" without generated scenes; "ranker-60fps"."""
        if self.network == "ranker":
            return f"{self.preset}-{self.fps}fps"
        if self.network == "relations":
            return self.preset if self.data == "generated" else f"{self.preset}-basic"
        return f"{self.preset}-{self.network}"

    def to_json(self) -> dict[str, Any]:
        """The settings as a JSON object."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name not in self.LATER or value}


# Cleaned up: scaled times, one anneal, every game and class counts alike, and a network chosen on held-out plays.
_CLEAN: Final = OutcomeConfig(
    preset="clean",
    half_period=0,
    time_scale=15.0,
    removal_flag=True,
    masked_times=False,
    equal_weights=True,
    keep_best=True,
)
_RELATIONS: Final = OutcomeConfig(
    preset="relations",
    network="relations",
    data="generated",
    epochs=40,
    batch_size=256,
    learning_rate=2e-3,
    half_period=0,
    weight_decay=1e-4,
    time_scale=1.0,
    removal_flag=True,
    masked_times=False,
    draws=25_600,
    mirrored=True,
    chunk=1,
    basic_share=0.25,  # of 16,010 scenes drawn alike the ten games would be one in 1,600
)
# It learns longer than `relations`, for time alone decides: each play is seen about eight times.
_RANKER: Final = dataclasses.replace(
    _RELATIONS,
    preset="ranker",
    network="ranker",
    data="pool",
    seeds=1,
    epochs=80,
    batch_size=768,
    plans_per_scene=24,
    learning_rate=1e-3,
    weight_decay=1e-2,
    draws=230_400,
    width=96,
    basic_share=0.0,
)


def settings(preset: PresetName = "paper", network: NetworkName | None = None) -> OutcomeConfig:
    """The settings of a preset with a network.

    Args:
        preset: "paper", "clean", "relations" or "ranker".
        network: by default the preset's first: "global", "relations" or "ranker".

    Raises:
        ValueError: one line; there is no such preset or network.
    """
    check_option("preset", preset, PRESETS)
    base = {"paper": OutcomeConfig(), "clean": _CLEAN, "relations": _RELATIONS, "ranker": _RANKER}[preset]
    chosen = base.network if network is None else network
    check_option("network", chosen, NETWORKS)
    config = dataclasses.replace(base, network=chosen)
    if chosen == "vision":  # pictures are dear: fewer, larger steps, with as many swings
        if config.mirrored:
            raise ValueError(f"network: expected another than vision with {preset}, which mirrors tables, not pictures")
        ratio = VISION_BATCH // config.batch_size
        config = dataclasses.replace(config, batch_size=VISION_BATCH, half_period=config.half_period // ratio)
    return config
