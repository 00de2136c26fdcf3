"""Trained policies that ship with the package: the best seed of an agent of docs/results/results.md.

`origin` names the training, one of the seeds of results.md. Each is two files of `weights/`.
They are data and run no code when loaded:

NAME.npz    the arrays that inference needs, in float16
NAME.json   settings, SHA-256 of NAME.npz, how the seed was chosen, where it was trained, and the scores of these
            weights, which a new evaluation must reproduce

`make results` writes them; `iphyre-jax verify-pretrained NAME` plays one and compares.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.files import pack_npz, read_npz, read_versioned, replace_bytes, replace_json
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import GAMES, SceneLike
from iphyre_jax.train.algos.base import State
from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.evaluate import Evaluation, evaluate
from iphyre_jax.train.observations import observation_length
from iphyre_jax.train.settings import old_names
from iphyre_jax.train.settings.codec import config_from_json
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.weights import restored, verify_sum

SCHEMA: Final = "iphyre_jax/pretrained"
VERSION: Final = 2  # version 1 has the names of `old_names`
WEIGHTS: Final = Path(str(files("iphyre_jax.train").joinpath("weights")))
SLACK: Final = 2**24  # bytes of NAME.npz beyond those of the arrays: headers, and arrays of another shape, to name them


@dataclass(frozen=True, eq=False)
class Pretrained:
    """A trained policy.

    Attributes:
        name: of the policy, as `names` lists it: "ppo-i".
        config: settings of its training; strategy, observation and rate decide where it can play.
        state: of its algorithm, for inference only.
        scores: "splits" and "games" of its evaluation, as in evaluation.json.
        origin: how the seed was chosen and where it was trained.
    """

    name: str
    config: TrainConfig
    state: State
    scores: Mapping[str, Any]
    origin: Mapping[str, Any]

    def greedy(self, observation: jax.Array) -> jax.Array:
        """The likeliest action for each observation (B, D), as the strategy's environment takes it.

        On the fly the scores are those of `greedy_policy`, which acts at the median of the policy's time.

        Raises:
            ValueError: an observation of another shape; one line.
        """
        return algorithm(self.config).greedy(self.state, self._checked(observation))

    def greedy_policy(self) -> Callable[[jax.Array], jax.Array]:
        """The preferred actions of B whole episodes, as the scores have them.

        Call it with the observations (B, D) of each decision in turn; begin the next episodes with a new one.
        """
        preferred = algorithm(self.config).greedy_policy(self.state)
        return lambda observation: preferred(self._checked(observation))

    def act(self, key: jax.Array, observation: jax.Array) -> jax.Array:
        """A sampled action for each observation (B, D), as the agent plays to learn; errors as `greedy`."""
        return algorithm(self.config).sample_action(self.state, key, self._checked(observation)).action

    def evaluate(self, games: Sequence[SceneLike] = GAMES) -> Evaluation:
        """Play games as the scores were played: once greedily, and with sampled actions; see `train.evaluate`."""
        return evaluate(self.config, self.state, games)

    def _checked(self, observation: jax.Array) -> jax.Array:
        config = self.config
        size = observation_length(config.strategy, config.observation, bool(config.prediction))
        if jnp.ndim(observation) != 2 or jnp.shape(observation)[1] != size:
            raise ValueError(f"observation: expected shape (B, {size}), got {jnp.shape(observation)}")
        return observation


def names(folder: Path = WEIGHTS) -> tuple[str, ...]:
    """The names of the policies."""
    return tuple(sorted(file.stem for file in folder.glob("*.npz")))


def load_pretrained(name: str, folder: Path = WEIGHTS) -> Pretrained:
    """A trained policy of the package, or of another folder.

    Raises:
        ValueError: one line; the name is unknown, or its files are damaged.
    """
    described, arrays = folder / f"{name}.json", folder / f"{name}.npz"
    if not (described.is_file() and arrays.is_file()):
        raise ValueError(f"pretrained: expected one of {', '.join(names(folder)) or 'none'}; got {name!r}")
    content = _description(described)
    old = content["version"] == 1
    config = config_from_json(content["settings"], described, old=old)
    state = _state(config, arrays, content["sha256"], old=old)
    return Pretrained(name, config, state, content["scores"], content["origin"])


def rounded(config: TrainConfig, state: State) -> State:
    """Reduce the state of an algorithm to what inference needs, rounded to float16."""
    inference = algorithm(config).inference_state(state)
    return jax.device_put(jax.tree.map(lambda leaf: _stored(leaf).astype(leaf.dtype), inference))


def save_pretrained(
    name: str, config: TrainConfig, state: State, scores: Mapping[str, Any], origin: Mapping[str, Any], folder: Path
) -> None:
    """Write the two files of a policy.

    Args:
        name: of the policy.
        config: settings of its training.
        state: `rounded`.
        scores: "splits", "games" and "faults" of the evaluation of this state.
        origin: JSON values: how the policy was chosen and where it was trained.
        folder: to write into.
    """
    packed = pack_npz({key: _stored(leaf) for key, leaf in named_arrays(state).items()})
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "agent": config.agent_name,
        "settings": config.to_json(),
        "sha256": hashlib.sha256(packed).hexdigest(),
        "origin": {**origin, "evaluated": provenance()},
        "scores": {key: scores[key] for key in ("splits", "games", "faults")},
    }
    folder.mkdir(parents=True, exist_ok=True)
    replace_bytes(folder / f"{name}.npz", packed)
    replace_json(folder / f"{name}.json", content)


def differences(policy: Pretrained, evaluation: Evaluation) -> list[str]:
    """One line for each mean reward of a game, greedy or sampled, that differs from the policy's shipped one.

    On the machine and with the versions of `origin` there are none. Elsewhere float32 physics and networks may round
    differently, and a few episodes may end differently.
    """
    shipped = {game["game"]: game for game in policy.scores["games"]}
    return [
        f"{game.game}, {kind}: {found:.1f}, shipped {wanted:.1f}"
        for game in evaluation.games
        for kind in ("greedy", "sampled")
        if (found := getattr(game, kind).reward) != (wanted := shipped[game.game][kind]["reward"])
    ]


def _description(file: Path) -> dict[str, Any]:
    """The content of NAME.json."""
    content = read_versioned(file, SCHEMA, (1, VERSION))
    for key in ("settings", "sha256", "origin", "scores"):
        if key not in content:
            raise ValueError(f"{file}: {key} is missing")
    return content


def _stored(leaf: jax.Array) -> np.ndarray[Any, Any]:
    """Floats as float16, other numbers unchanged."""
    array = np.asarray(leaf)
    return array.astype(np.float16) if array.dtype.kind == "f" else array


def _state(config: TrainConfig, source: Path, sha256: str, *, old: bool) -> State:
    """The state in NAME.npz, whose arrays may have old names.

    Raises:
        ValueError: one line naming `source`; it is damaged, or its arrays are not those of the settings.
    """
    like = jax.eval_shape(lambda: algorithm(config).inference_state(init(config, jax.random.key(0))))
    most = sum(leaf.size * leaf.dtype.itemsize for leaf in named_arrays(like).values()) + SLACK
    verify_sum(source, sha256)
    arrays = {old_names.array_path(key) if old else key: array for key, array in read_npz(source, most).items()}
    state: State = restored(arrays, like, source)
    return state
