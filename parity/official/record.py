"""Record random episodes of the official class, in a virtual environment of its own.

    PYTHON parity/official/record.py FILE --episodes N --pictures FILE

That environment holds iphyre 0.2.3, pymunk 6.11.1, NumPy below 2 and pygame; this file and `drivers.py` need nothing
else. `parity.official.environments` then compares the episodes and `parity.official.pictures` the pictures of the
starts. `make parity-official` runs all three.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))  # the package is not installed there

import drivers  # type: ignore[import-not-found]


def record(game: str, strategy: str, seed: int) -> dict[str, Any]:
    """Play one episode of the official class and return actions and transitions as arrays."""
    from iphyre.simulator import IPHYRE

    stream = drivers.random_actions(strategy, np.random.default_rng(seed))
    taken: list[Any] = []

    def recorded_stream() -> Iterator[Any]:
        for action in stream:
            taken.append(action)
            yield action

    episode = drivers.DRIVERS[strategy](IPHYRE(game=game, fps=10), recorded_stream())
    steps = episode.transitions
    return {
        "actions": np.array(taken),
        "observations": np.stack([episode.start, *(step.observation for step in steps)]),
        "rewards": np.array([step.reward for step in steps]),
        "terminated": np.array([step.terminated for step in steps]),
        "truncated": np.array([step.truncated for step in steps]),
    }


def pictures(games: list[str]) -> dict[str, Any]:
    """The official picture of each game's start, (600, 600, 3) uint8 in red, green, blue; no window opens."""
    os.environ.update(SDL_VIDEODRIVER="dummy", SDL_AUDIODRIVER="dummy")
    from iphyre.simulator import IPHYRE

    drawn = {}
    for game in games:
        simulator = IPHYRE(game=game)
        simulator.init_screen()
        drawn[game] = np.array(simulator.reset(use_images=True))[:, :, ::-1]
    return drawn


def main() -> None:
    """Record episodes of every game and strategy into one file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--pictures", type=Path, default=None, help="file for the pictures of the starts")
    options = parser.parse_args()
    from iphyre.games import GAMES

    arrays: dict[str, Any] = {}
    episodes = [
        (game, strategy, n) for game in GAMES[:40] for strategy in drivers.DRIVERS for n in range(options.episodes)
    ]
    for index, (game, strategy, _) in enumerate(episodes):
        for name, array in record(game, strategy, index).items():
            arrays[f"{index}/{name}"] = array
    arrays["episodes"] = np.array(json.dumps(episodes))
    np.savez_compressed(options.file, **arrays)
    print(f"{len(episodes)} episodes recorded in {options.file}")
    if options.pictures:
        np.savez_compressed(options.pictures, **pictures(GAMES[:40]))


if __name__ == "__main__":
    main()
