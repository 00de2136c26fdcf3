"""Compare the environments with the official class: replay episodes that `parity.official.record` recorded."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from iphyre_jax.envs import Environment, EnvParams, EnvState, make
from iphyre_jax.scenes import GAMES
from parity.tolerances import OBSERVATION

Recorded = dict[str, np.ndarray[Any, Any]]


def load(path: Path) -> list[tuple[str, str, Recorded]]:
    """Read a file of `parity.official.record`: game, strategy and arrays of each episode."""
    with np.load(path) as file:
        arrays: dict[int, Recorded] = {}
        for key in file.files:
            if key != "episodes":
                index, name = key.split("/")
                arrays.setdefault(int(index), {})[name] = file[key]
        episodes = json.loads(str(file["episodes"]))
    return [(game, strategy, arrays[index]) for index, (game, strategy, _) in enumerate(episodes)]


def replay(environment: Environment, params: EnvParams, game_index: ArrayLike, actions: ArrayLike) -> Recorded:
    """Play B episodes of actions (B, T, ...) from rows (B,) of the parameters; one that has ended does not change."""

    def episode(game: jax.Array, actions: jax.Array) -> dict[str, jax.Array]:
        obs, state = environment.reset_to(game, params)

        def one(state: EnvState, action: jax.Array) -> tuple[EnvState, tuple[jax.Array, ...]]:
            out = environment.step(jax.random.key(0), state, action, params)
            return out[1], (out[0], out[2], out[3], out[4])

        _, (later, rewards, terminated, truncated) = jax.lax.scan(one, state, actions)
        observations = jnp.concatenate([obs[None], later])
        return {"observations": observations, "rewards": rewards, "terminated": terminated, "truncated": truncated}

    played = jax.jit(jax.vmap(episode))(jnp.asarray(game_index, jnp.int32), jnp.asarray(actions))
    return {name: np.asarray(value) for name, value in played.items()}


def differences(recorded: Recorded, played: Recorded) -> list[str]:
    """One line for each way in which an episode differs; empty if it does not."""
    steps = len(recorded["rewards"])
    problems = [
        f"{name} {played[name][:steps].tolist()}, official {recorded[name].tolist()}"
        for name in ("terminated", "truncated")
        if (played[name][:steps] != recorded[name]).any()
    ]
    # The environment's rewards are float32.
    if not np.allclose(played["rewards"][:steps], recorded["rewards"], rtol=1e-6, atol=1e-4):
        problems.append(f"rewards {played['rewards'][:steps].sum()}, official {recorded['rewards'].sum()}")
    error = np.abs(played["observations"][: steps + 1] - recorded["observations"]).max()
    if not error <= OBSERVATION:
        problems.append(f"observations differ by {error:g}")
    return problems


def compare(episodes: list[tuple[str, str, Recorded]], strategy: str) -> list[str]:
    """Replay the episodes of a strategy in float64 with the official bugs; one line for each difference."""
    chosen = [(game, recorded) for game, of, recorded in episodes if of == strategy]
    length = max(len(recorded["actions"]) for _, recorded in chosen)
    actions = np.stack([_padded(recorded["actions"], length) for _, recorded in chosen])
    with jax.enable_x64(True):
        environment, params = make(f"{strategy}/all-v1", dtype="float64", autoreset=False, official_bugs=True)
        played = replay(environment, params, [GAMES.index(game) for game, _ in chosen], actions)
    lines, steps, equal, numbers = [], 0, 0, 0
    for index, (game, recorded) in enumerate(chosen):
        own = {name: value[index] for name, value in played.items()}
        lines += [f"{strategy} {game} {index}: {problem}" for problem in differences(recorded, own)]
        steps += len(recorded["rewards"])
        observed, bits = recorded["observations"], np.dtype("int32")
        equal += int((own["observations"][: len(observed)].view(bits) == observed.view(bits)).sum())
        numbers += observed.size
    print(f"{strategy}: {len(chosen)} episodes, {steps} steps, {len(lines)} differences")
    print(f"{strategy}: {equal:,} of {numbers:,} numbers of the observations equal to the last bit")
    return lines


def _padded(actions: np.ndarray[Any, Any], length: int) -> np.ndarray[Any, Any]:
    if actions.ndim == 1:
        actions = actions.astype(np.int32)
    return np.concatenate([actions, np.repeat(actions[-1:], length - len(actions), axis=0)])


def main() -> int:
    """Compare a file of recorded episodes; return 1 if one differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    episodes = load(parser.parse_args().file)
    lines = [line for strategy in dict.fromkeys(of for _, of, _ in episodes) for line in compare(episodes, strategy)]
    print("\n".join(lines))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
