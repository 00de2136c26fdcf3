"""The attempts of one person: five per game, each saved as a line in a file of plays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from threading import Lock
from typing import Final

from iphyre_jax.provenance import CORE, device, versions
from iphyre_jax.scenes import Scene
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.plays import Play, append_play, open_plays, play_to_json, result_of
from iphyre_jax.viewer.recording import Recording

ATTEMPTS: Final = 5  # as for the people in the paper
MAX_ATTEMPTS: Final = 10_000  # of one server, which keeps them in memory


@dataclass
class _Series:
    """Up to five attempts at one scene that count together."""

    number: int
    tries: list[Play] = field(default_factory=list)


class Session:
    """Counts and saves attempts. An attempt counts once it is on disk.

    Opening makes the file ready: what an earlier process left of a half line is cut, with a warning.

    Args:
        path: the file of plays to which attempts are added; None to save none.
        name: the name of the person in the file.

    Raises:
        OSError: the file cannot be read or written.
        ValueError: the file holds something else than plays; one line.
    """

    def __init__(self, path: Path | None, name: str = "you") -> None:
        self._path, self._name = path, name
        if path is not None:
            open_plays(path)
        self._saved = 0
        self._lock = Lock()
        self._series: dict[Scene, _Series] = {}  # a scene with an attempt

    def add(self, recording: Recording) -> dict[str, object]:
        """Count and save an attempt; return the standing after it.

        Raises:
            RefusedError: all attempts are used, or the attempt cannot be saved; it does not count then.
        """
        with self._lock:
            series = self._series.get(recording.scene) or _Series(1)
            if len(series.tries) >= ATTEMPTS:
                raise RefusedError(409, f"all {ATTEMPTS} attempts are used")
            if self._saved >= MAX_ATTEMPTS:
                raise RefusedError(409, f"{MAX_ATTEMPTS} attempts are saved; start the server again")
            facts = {"attempt": len(series.tries) + 1, "series": series.number, **_provenance()}
            if self._path is not None:
                self._save(self._path, play_to_json(recording, self._name, facts))
            self._saved += 1
            self._series[recording.scene] = series
            agent = f"attempt {len(series.tries) + 1}"
            series.tries.append(
                Play(agent, recording.scene, recording.plan, recording.fps, result=result_of(recording))
            )
            return _series_standing(series)

    def begin_again(self, scene: Scene) -> dict[str, object]:
        """Begin a new series of attempts at a scene and return its standing."""
        with self._lock:
            series = self._series.get(scene) or _Series(1)
            if series.tries:
                series = self._series[scene] = _Series(series.number + 1)
            return _series_standing(series)

    def standing(self, scene: Scene) -> dict[str, object]:
        """Return the standing of the current series: rewards, the best one, attempts left."""
        with self._lock:
            return _series_standing(self._series.get(scene) or _Series(1))

    def attempts(self, scene: Scene) -> list[Play]:
        """Return the attempts of the current series."""
        with self._lock:
            return list(self._series[scene].tries) if scene in self._series else []

    @staticmethod
    def _save(path: Path, line: Mapping[str, object]) -> None:
        try:
            append_play(path, line)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise RefusedError(507, f"this attempt was not saved and does not count: {reason}") from error


def _series_standing(series: _Series) -> dict[str, object]:
    rewards = [float(str(play.result["reward"])) for play in series.tries if play.result]
    return {
        "series": series.number,
        "rewards": rewards,
        "left": ATTEMPTS - len(rewards),
        "best": max(rewards, default=None),
    }


def _provenance() -> dict[str, object]:
    """Return time, versions and device, for a line in the file of plays."""
    return {
        "when": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": versions(CORE),
        "device": device(),
    }
