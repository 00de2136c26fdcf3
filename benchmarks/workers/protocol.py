"""The protocol of driver and worker: one line of JSON each way."""

import json
import os
import resource
import sys
import time
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any

KIB = 1024 if sys.platform != "darwin" else 1  # bytes a unit of ru_maxrss


@dataclass(frozen=True)
class Job:
    """Plans to play; the same for every engine.

    Attributes:
        scenes: scene files' contents, as dictionaries.
        which: index of each plan's scene.
        plans: six columns; the step before which each eliminable block is removed, -1 for never.
        fps: physics steps a second.
        steps: the most steps of an episode.
    """

    scenes: list[dict[str, Any]]
    which: list[int]
    plans: list[list[int]]
    fps: int
    steps: int


@dataclass(frozen=True)
class EpisodeResults:
    """The results of a job, one entry a plan: steps made, success, reward."""

    steps: list[int]
    success: list[bool]
    reward: list[float]


class Player(ABC):
    """An engine in a worker."""

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Versions of the packages that matter for speed."""

    @abstractmethod
    def load(self, job: Job) -> None:
        """Take a job and do everything that is done once for it."""

    def ready(self) -> None:  # noqa: B027 - most players have nothing to prepare
        """Prepare one play; not timed."""

    @abstractmethod
    def play(self) -> None:
        """Play all plans of the job; timed."""

    @abstractmethod
    def results(self) -> EpisodeResults:
        """The results of the last play."""


def with_rewards(job: Job, steps: list[int], success: list[bool]) -> EpisodeResults:
    """The results of a job with the game's rewards."""
    rewards = [
        1000.0 * solved - 10.0 * sum(0 <= at < end for at in plan) - end / job.fps
        for plan, end, solved in zip(job.plans, steps, success, strict=True)
    ]
    return EpisodeResults(steps, success, rewards)


def serve(player: Player) -> None:
    """Answer the driver until it closes the pipe.

    The first line holds the versions. "load" plays once, so that nothing is left to compile, and answers with results
    and seconds. "ready" has an empty answer. "play" answers with its processor seconds and the most memory that the
    process has ever held; the driver measures wall-clock time itself.
    """
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # an engine's own prints must not look like an answer
    print(json.dumps(player.versions()), file=answers)
    for line in sys.stdin:
        message = json.loads(line)
        answer: dict[str, Any] = {}
        if message["do"] == "load":
            begin = time.perf_counter()
            player.load(Job(**message["job"]))
            player.ready()
            player.play()
            answer = {"seconds": time.perf_counter() - begin, **asdict(player.results())}
        elif message["do"] == "ready":
            player.ready()
        else:
            cpu = time.process_time()
            player.play()
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KIB
            answer = {"processor_seconds": time.process_time() - cpu, "memory": most}
        print(json.dumps(answer), file=answers)
