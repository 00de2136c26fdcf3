"""Train the classifier that chooses among a policy's plans, on plays of the scenes that the policy may learn from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final, NamedTuple

from rich.console import Console

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome import runs, storage
from iphyre_jax.models.outcome.plays.augmented import joined
from iphyre_jax.models.outcome.plays.hard import hard_plays
from iphyre_jax.models.outcome.plays.pool import pool_plays
from iphyre_jax.models.outcome.plays.proposals import Propose, random_proposals
from iphyre_jax.models.outcome.plays.sets import compact
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.training import Params, chosen
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import Scene

HELD: Final = 40  # one scene in so many is held out, to watch the training; nothing is chosen by it
REFINED_EPOCHS: Final = 40  # of a refinement ...
REFINED_RATE: Final = 3e-4  # ... and its first learning rate
LISTWISE: Final = 1.0  # weight of the listwise loss where policies propose: the list is what the ranker chooses from


class Refinement(NamedTuple):
    """A further training of a ranker.

    Attributes:
        scenes: gives scenes that nothing has learned from before, if they are needed.
        propose: gives the plans of which the ranker picks those that are played; None: random ones.
    """

    scenes: Callable[[], Sequence[Scene]]
    propose: Propose | None = None


def trained_ranker(
    folder: Path,
    generated: Sequence[Scene],
    config: OutcomeConfig,
    console: Console,
    refinements: Sequence[Refinement] = (),
) -> storage.OutcomeClassifier:
    """The ranker of a folder; what is missing is played and trained, or the rest of it.

    A refinement goes on from the ranker before it. It plays those plans of fresh scenes that this one believes in, over
    half of which fail, and learns from all plays so far; where policies propose, from those of such refinements alone.

    Args:
        folder: of plays, run and network; for these scenes and settings alone. Refinements are in folders of it.
        generated: scenes to learn from, beside basic games and variations.
        config: settings with one seed.
        console: for progress.
        refinements: in order.

    Raises:
        ValueError: one line; the folder holds another ranker, or a damaged one.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    return _Stages(folder, generated, config, console, refinements).ranker(len(refinements))


@dataclass(frozen=True)
class _Stages:
    """The trainings of a ranker: 0 is the first, the others are refinements. Each is found in its folder or made."""

    folder: Path
    generated: Sequence[Scene]
    config: OutcomeConfig
    console: Console
    refinements: Sequence[Refinement]

    def ranker(self, number: int) -> storage.OutcomeClassifier:
        """The ranker after a stage."""
        folder, config = stage_folder(self.folder, number), self._config(number)
        if config.name not in storage.FILES.names(folder):
            params = self.ranker(number - 1).params if number else None
            self._train(folder, config, [self._plays(stage) for stage in self._learned(number)], params)
        return _loaded(folder, config)

    def _config(self, number: int) -> OutcomeConfig:
        return refined(self.config, by_policies=self._by_policies(number)) if number else self.config

    def _by_policies(self, number: int) -> bool:
        return number > 0 and self.refinements[number - 1].propose is not None

    def _learned(self, number: int) -> list[int]:
        """The stages whose plays a stage learns from, its own the last."""
        return [stage for stage in range(number + 1) if self._by_policies(stage) == self._by_policies(number)]

    def _plays(self, number: int) -> Dataset:
        """The plays of a stage."""
        folder = stage_folder(self.folder, number) / "plays"
        if not number:
            return pool_plays(self.generated, self.config, folder, self.console)
        scenes, propose = self.refinements[number - 1]
        params, config = self.ranker(number - 1).params, refined(self.config)
        return hard_plays(scenes(), config, params, number - 1, folder, self.console, propose or random_proposals)

    def _train(self, folder: Path, config: OutcomeConfig, plays: Sequence[Dataset], params: Params | None) -> None:
        """Train from plays of which the last ones are new, and from the parameters of the stage before."""
        held = [each.game % HELD == 0 for each in plays]
        parts = [compact(each.select(~out)) for each, out in zip(plays, held, strict=True)]
        learned, watched = joined(parts), runs.sampled(compact(plays[-1].select(held[-1])))
        state = runs.train(folder / "run", config, learned, watched, self.console, params)
        kept = storage.shipped_params(chosen(config, state), 0)
        origin = {"seed": 0, "plays": len(learned), "scenes": len(learned.scenes), "trained": provenance()}
        storage.FILES.save(folder, storage.OutcomeClassifier(config.name, config, kept, origin))


def refined(config: OutcomeConfig, *, by_policies: bool = False) -> OutcomeConfig:
    """Settings of a refinement."""
    listwise = LISTWISE if by_policies else config.listwise
    return replace(config, epochs=REFINED_EPOCHS, learning_rate=REFINED_RATE, listwise=listwise)


def stage_folder(folder: Path, refinements: int) -> Path:
    """Where the ranker after so many refinements is kept."""
    return folder / f"refined-{refinements}" if refinements else folder


def _loaded(folder: Path, config: OutcomeConfig) -> storage.OutcomeClassifier:
    ranker = storage.load_classifier(config.name, folder)
    if ranker.config != config:
        name = next(one.name for one in fields(config) if getattr(config, one.name) != getattr(ranker.config, one.name))
        raise ValueError(f"{folder}: {name}: expected that of these settings, found another; remove the folder")
    return ranker
