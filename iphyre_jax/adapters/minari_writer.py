"""Write episodes as a Minari data set, the format of the Farama Foundation for offline learning. Extra `minari`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import missing_extra, show


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T decisions.

    Attributes:
        observations: (T + 1, ...) float32.
        actions: (T, S), float32 for a box, int8 for flags.
        rewards: (T,) float64.
        terminated: whether the last decision ended it.
        seed: its number.
        infos: arrays (T + 1, ...).
    """

    observations: npt.NDArray[np.float32]
    actions: npt.NDArray[Any]
    rewards: npt.NDArray[np.float64]
    terminated: bool
    seed: int
    infos: Mapping[str, npt.NDArray[Any]]


def check_minari(dataset_id: str, name: str = "dataset_id") -> None:
    """Check that a data set of this name can be written, before its episodes are made.

    Args:
        dataset_id: as Minari names data sets: "iphyre/official-v0".
        name: of the argument, for the message.

    Raises:
        ModuleNotFoundError: minari or h5py is missing; one line that names the extra.
        ValueError: Minari refuses the name, or has a data set of this name; one line.
    """
    try:
        import h5py  # noqa: F401 - of the storage
        import minari
        from minari.dataset.minari_dataset import parse_dataset_id
    except ModuleNotFoundError as error:
        raise missing_extra("a Minari data set", "minari", error.name) from None
    try:
        parse_dataset_id(dataset_id)
    except ValueError:
        raise ValueError(f"{name}: expected a name such as 'iphyre/official-v0', got {show(dataset_id)}") from None
    if dataset_id in minari.list_local_datasets():
        raise ValueError(f"{name}: expected a new name, but Minari has a data set {show(dataset_id)}")


def write_minari(dataset_id: str, episodes: Iterable[Episode], highest: float | None, description: str) -> Any:  # noqa: ANN401
    """Write episodes as a new Minari data set.

    Args:
        dataset_id: as Minari names data sets: "iphyre/official-v0".
        episodes: of one shape.
        highest: actions are a box from 0 to this; None: flags.
        description: what a reader should know.

    Returns:
        The `minari.MinariDataset`.

    Raises:
        ModuleNotFoundError: see `check_minari`.
        ValueError: see `check_minari`, or there are no episodes; one line.
    """
    check_minari(dataset_id)
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    all_of = list(episodes)
    if not all_of:
        raise ValueError("dataset: expected at least one play")
    first = all_of[0]
    slots, shape = first.actions.shape[1], first.observations.shape[1:]
    action_space = spaces.MultiBinary(slots) if highest is None else spaces.Box(0.0, highest, (slots,), np.float32)
    buffers = [EpisodeBuffer(**_fields(number, episode)) for number, episode in enumerate(all_of)]
    return minari.create_dataset_from_buffers(
        dataset_id,
        buffers,
        action_space=action_space,
        observation_space=spaces.Box(-np.inf, np.inf, shape, np.float32),
        description=description,
        data_format="hdf5",
    )


def _fields(number: int, episode: Episode) -> dict[str, Any]:
    """Return the arguments of an `EpisodeBuffer`."""
    ends = np.zeros((2, len(episode.rewards)), bool)
    ends[0 if episode.terminated else 1, -1] = True
    return {
        "id": number,
        "seed": episode.seed,
        "observations": episode.observations,
        "actions": episode.actions,
        "rewards": episode.rewards.tolist(),
        "terminations": ends[0].tolist(),
        "truncations": ends[1].tolist(),
        "infos": dict(episode.infos),
    }
