"""The official package's own `iphyre.utils`, unedited, over `iphyre_jax.compat`; its data collection, its environments.

The file is that of iphyre 0.2.3. Its imports of the simulator and the games find those of `iphyre_jax.compat`, as the
changed import lines of a user's script do; so neither pymunk nor pygame is needed.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from score import Score, leave, now, record

from iphyre_jax import compat

GAME, GAMES = "hole", ["hole", "support"]
KEPT = 8  # plans of a kind
TRIED, PLAYED = 60, 60  # random plans to choose from, and to compare with
sys.path.insert(0, str(Path(__file__).parents[2] / "parity" / "official"))
sys.modules["iphyre.simulator"] = compat  # type: ignore[assignment]
sys.modules["iphyre.games"] = types.SimpleNamespace(**vars(compat) | {"GAMES": GAMES})  # type: ignore[assignment]

import drivers  # noqa: E402
from iphyre import utils  # noqa: E402

Plans = tuple[list[list[float]], list[list[float]], int]


def plans(make: Callable[..., Plans], seed: int = 0) -> Plans:
    """Return plans that solve the game and plans that do not, with the arguments of the official script."""
    arguments = {"interval": 0.1, "max_game_time": 15.0, "max_action_time": 7.0, "max_step": compat.MAX_ELI_OBJ_NUM}
    with contextlib.redirect_stdout(io.StringIO()):
        return make(game=GAME, num_succeed=KEPT, num_fail=KEPT, seed=seed, **arguments)


def clicks(positions: list[list[float]], times: list[float]) -> list[list[float]]:
    """Return the clicks of a plan, as the official script makes them."""
    return [positions[i + 1] + [times[i]] for i in range(compat.MAX_ELI_OBJ_NUM)]


def collection() -> None:
    """The official scripts that collect: plans, starts of all games, sequences."""
    good, bad, tried = plans(utils.generate_actions)
    assert plans(compat.generate_actions) == (good, bad, tried)
    with tempfile.TemporaryDirectory() as folder:
        utils.collect_initial_all(save_path=f"{folder}/initial")
        assert {path.name for path in Path(folder, "initial").iterdir()} == set(GAMES)
        env = compat.IPHYRE(game=GAME)
        env.collect_initial_data(save_path=f"{folder}/initial/")
        positions = env.get_action_space()
        env.collect_seq_data(save_path=f"{folder}/sequences/", act_lists=[clicks(positions, one) for one in good[:2]])
        vectors = np.load(f"{folder}/sequences/{GAME}/0/vectors.npy")
        assert vectors.shape == (150, 12, 9)
        assert len(list(Path(folder, "sequences", GAME, "0", "images").iterdir())) == vectors.any((1, 2)).sum()


def environments() -> None:
    """The loops of its three environments, and its play scripts, which say what to use without a window."""
    for strategy, drive in drivers.DRIVERS.items():
        stream = drivers.random_actions(strategy, np.random.default_rng(0))
        episode = drive(compat.IPHYRE(game=GAME, fps=10), stream)
        last = episode.transitions[-1]
        assert last.terminated or last.truncated
        assert last.observation.shape == episode.start.shape
    assert "use" in refusal(utils.play_all)
    assert "use" in refusal(lambda: utils.collect_play_all("player", 1, "player.json"))


def refusal(play: Callable[[], object]) -> str:
    """Return what a script says that would open a window."""
    try:
        play()
    except NotImplementedError as error:
        return str(error)
    raise AssertionError("expected NotImplementedError")


def search() -> bool:
    """Choose the best of some random plans with the calls of the README, and write the record."""
    env = compat.IPHYRE(game=GAME)
    positions, rng = env.get_action_space(), np.random.default_rng(0)

    def reward(times: list[float]) -> float:
        env.reset()
        solved, removed, seconds = env.simulate(clicks(positions, times))
        return 1000.0 * solved - 10.0 * removed - seconds

    def draw() -> list[float]:
        return [rng.uniform(0.1, 7.0) * (rng.random() > 0.2) for _ in range(compat.MAX_ELI_OBJ_NUM)]

    best = max((draw() for _ in range(TRIED)), key=reward)
    score, chance = Score.of([reward(best) for _ in range(10)]), Score.of([reward(draw()) for _ in range(PLAYED)])
    ran = f"best of {TRIED} random plans by IPHYRE.simulate, {GAME}"
    return record("official-search", "iphyre", ran, since=start, score=score, random=chance, fps=60)


if __name__ == "__main__":
    parts: dict[str, Callable[[], Any]] = {
        "generate_actions, collect_initial_all of its own iphyre.utils; collect_seq_data": collection,
        "loops of its three environments; play_all, collect_play_all refer to the play page": environments,
    }
    for number, (ran, run) in enumerate(parts.items()):
        start = now()
        run()
        record(f"official-{number + 1}", "iphyre", ran, since=start, fps=60 - 50 * number)
    start = now()
    leave(search())
