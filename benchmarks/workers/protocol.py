"""What the driver and a worker say to each other: one line of JSON each way."""

import json
import os
import resource
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any, Protocol

KIB = 1024 if sys.platform != "darwin" else 1  # bytes a unit of ru_maxrss


@dataclass(frozen=True)
class Job:
    """Plans to play; the same for every engine.

    Attributes:
        scenes: scene files' contents, as dictionaries.
        which: for each plan, its scene.
        plans: for each plan, the step before which each eliminable block is removed, -1 for never; six columns.
        fps: physics steps a second.
        steps: the most steps of an episode.
    """

    scenes: list[dict[str, Any]]
    which: list[int]
    plans: list[list[int]]
    fps: int
    steps: int


@dataclass(frozen=True)
class Played:
    """What came out, one entry a plan: steps really made, success, reward."""

    steps: list[int]
    success: list[bool]
    reward: list[float]


class Player(Protocol):
    """An engine in a worker."""

    def versions(self) -> dict[str, str]:
        """Packages that matter for the speed."""
        ...

    def load(self, job: Job) -> None:
        """Take a job; everything that is done once for it."""
        ...

    def ready(self) -> None:
        """Prepare one turn; not timed."""
        ...

    def play(self) -> None:
        """Play all plans of the job; timed."""
        ...

    def outcome(self) -> Played:
        """What the last turn came to."""
        ...


def reward(success: bool, removed: int, steps: int, fps: int) -> float:
    """The benchmark's reward of an episode."""
    return 1000.0 * success - 10.0 * removed - steps / fps


def removed_before(plan: list[int], steps: int) -> int:
    """Blocks that a plan has removed after so many steps."""
    return sum(0 <= at < steps for at in plan)


def serve(player: Player) -> None:
    """Answer the driver until it closes the line.

    The first line tells the versions. "load" is answered with the outcome of one complete play, which leaves nothing to
    compile, and its seconds; "ready" with an empty answer; "play" with the processor seconds that it took and the most
    memory that the process has ever held, for the driver holds the watch.
    """
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever an engine prints must not look like an answer
    print(json.dumps(player.versions()), file=answers)
    for line in sys.stdin:
        message = json.loads(line)
        answer: dict[str, Any] = {}
        if message["do"] == "load":
            begin = time.perf_counter()
            player.load(Job(**message["job"]))
            player.ready()
            player.play()
            answer = {"seconds": time.perf_counter() - begin, **asdict(player.outcome())}
        elif message["do"] == "ready":
            player.ready()
        else:
            cpu = time.process_time()
            player.play()
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KIB
            answer = {"processor_seconds": time.process_time() - cpu, "memory": most}
        print(json.dumps(answer), file=answers)
