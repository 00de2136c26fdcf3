"""Run folders: what a training run leaves behind, and how it is read again.

config.json       settings, versions, device, commit
metrics.csv       one line a round, written as it goes
curve.png         learning curve
checkpoint/       state of the run (orbax)
evaluation.json   and evaluation.md: the trained policy's games
"""

from __future__ import annotations

import csv
import dataclasses
import json
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from iphyre_jax.train import checkpoint, ppo
from iphyre_jax.train.config import TrainConfig, config_from_json
from iphyre_jax.train.curve import draw_curve
from iphyre_jax.train.evaluate import Evaluation
from iphyre_jax.train.provenance import provenance
from iphyre_jax.train.report import agent_name, markdown

SCHEMA = "iphyre_jax/run"
VERSION = 1


@dataclass(frozen=True)
class Round:
    """One line of metrics.csv."""

    update: int
    """Rounds made."""
    episodes: int
    """Episodes played for learning, up to and with this round."""
    seconds: float
    """Wall time since the start of the run, s."""
    reward: float
    """Mean reward of the round's sampled plans."""
    success: float
    """Share of them that solved their game."""
    greedy_reward: float | None
    """Mean reward of greedy plans before the round's learning, if it was measured."""
    policy_loss: float
    entropy: float
    """Nats per slot."""
    kl: float
    """How far the policy moved, nats per episode."""
    clipped: float
    """Share of episodes whose ratio left the clip range."""
    grad_norm: float
    faults: int
    """Episodes whose world was reported as unsound."""
    play_seconds: float
    """Wall time of the round's simulation, s."""
    learn_seconds: float
    """Wall time of the round's sampling and learning, s."""


@dataclass
class RunFolder:
    """An open run folder that is being written."""

    path: Path
    config: TrainConfig
    rounds: list[Round] = field(default_factory=list)

    def log(self, line: Round) -> None:
        """Append a line to metrics.csv; it is in the file before this returns."""
        values = ["" if value is None else value for value in dataclasses.astuple(line)]
        self._append([f"{value:.6g}" if isinstance(value, float) else str(value) for value in values])
        self.rounds.append(line)

    def write_header(self) -> None:
        """Start metrics.csv."""
        self._append([entry.name for entry in dataclasses.fields(Round)])

    def _append(self, cells: list[str]) -> None:
        """Add a line to metrics.csv."""
        with (self.path / "metrics.csv").open("a", encoding="utf-8", newline="") as file:
            csv.writer(file).writerow(cells)

    def close(self, state: ppo.TrainState) -> None:
        """Save the checkpoint and the learning curve of what was done."""
        checkpoint.save(self.path, state)
        draw_curve(
            self.path / "curve.png",
            self.config,
            [line.episodes for line in self.rounds],
            [line.reward for line in self.rounds],
            [(line.episodes, line.greedy_reward) for line in self.rounds if line.greedy_reward is not None],
        )


def default_path(config: TrainConfig, root: Path = Path("runs")) -> Path:
    """A new folder's path, named after the run and the time."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    trained_on = "some-games" if config.games else config.split
    return root / f"ppo-in-advance-{config.head}-{trained_on}-{config.fps}fps-seed{config.seed}-{stamp}"


def create(path: Path, config: TrainConfig) -> RunFolder:
    """Make a run folder and write its config.json.

    Raises:
        ValueError: one line; a setting cannot work, or the path exists and is not an empty folder.
    """
    config.check()
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"{path}: expected a new or empty folder for the run")
    path.mkdir(parents=True, exist_ok=True)
    facts = {"started": datetime.now().astimezone().isoformat(timespec="seconds"), **provenance()}
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "agent": agent_name(config),
        "settings": config.to_json(),
        **facts,
    }
    _write_json(path / "config.json", content)
    folder = RunFolder(path, config)
    folder.write_header()
    return folder


def load(path: Path) -> tuple[TrainConfig, ppo.TrainState]:
    """Settings and state of a finished or interrupted run.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    file = path / "config.json"
    if not file.is_file():
        raise FileNotFoundError(f"{path}: not a run folder, there is no config.json")
    try:
        content = json.loads(file.read_text("utf-8"))
    except ValueError as error:
        raise ValueError(f"{file}: not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ValueError(f'{file}: schema: expected "{SCHEMA}"')
    if content.get("version") != VERSION:
        raise ValueError(f"{file}: version: expected {VERSION}, got {content.get('version')!r}")
    config = config_from_json(content.get("settings"), file)
    return config, checkpoint.load(path, config)


def write_evaluation(path: Path, config: TrainConfig, evaluation: Evaluation, rounds: int) -> None:
    """Write evaluation.json and evaluation.md into a run folder.

    Args:
        path: of the folder.
        config: of the run.
        evaluation: of the policy.
        rounds: that the policy was trained for.
    """
    facts = {
        "rounds trained": f"{rounds} of {config.updates}, {rounds * config.episodes_per_update} episodes",
        **provenance(),
    }
    content = {"agent": agent_name(config), "settings": config.to_json(), **facts, **evaluation.to_json()}
    _write_json(path / "evaluation.json", content)
    (path / "evaluation.md").write_text(markdown(evaluation, config, facts), "utf-8")


def _write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON."""
    path.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
