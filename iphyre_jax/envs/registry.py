"""Environments by name: "strategy/games-vN". A change of physics or rules gives a new number, so old results stand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Final, get_args

from iphyre_jax.checks import check_dtype, check_flag, check_option, check_whole, show
from iphyre_jax.envs.core import MAX_IMAGE, BackendName, Environment
from iphyre_jax.envs.params import EnvParams
from iphyre_jax.envs.protocols import EpisodeProtocol, protocol_named
from iphyre_jax.envs.strategies import STRATEGIES, strategy_named
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import on_cpu
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.observations.vectors import ObservationName
from iphyre_jax.physics.shared_topologies import shared_topologies
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import SPLITS, Limits, Scene, SceneLike, load_scenes
from iphyre_jax.scenes.library import GAME_LISTS

VERSION: Final = "v1"  # of the physics and of the strategies' rules

_MAX_ID: Final = 100  # characters
_NAME: Final = re.compile(r"[\w.-]+-v(0|[1-9][0-9]*)", re.ASCII)  # what the registry of gymnasium can read
_REGISTERED: dict[str, tuple[SceneLike, ...]] = {}


def _known() -> dict[str, tuple[SceneLike, ...]]:
    """Return the sets of games by name: all forty, the splits, and every single game."""
    sets: dict[str, tuple[SceneLike, ...]] = dict(GAME_LISTS)
    sets.update({game: (game,) for games in SPLITS.values() for game in games})
    return {f"{name}-{VERSION}": games for name, games in sets.items()} | _REGISTERED


def environment_ids() -> tuple[str, ...]:
    """Return every id that `make` takes: three strategies for each set of games."""
    return tuple(f"{strategy}/{games}" for strategy in STRATEGIES for games in _known())


def register(name: str, scenes: Sequence[SceneLike], *, overwrite: bool = False) -> None:
    """Name a set of your own games, for all three strategies; the same set may take its name again.

    Args:
        name: with a version, as "mine-v1", which makes "in-advance/mine-v1" and so on; of ASCII letters, digits, "_",
            "." and "-".
        scenes: names, files or scenes; read when the environment is made.
        overwrite: whether a name of your own may get other scenes; environments made before keep theirs.

    Raises:
        ValueError: the name has another form or is taken, or there are no scenes; one line.
    """
    if not isinstance(name, str) or len(name) > _MAX_ID or not _NAME.fullmatch(name):
        wanted = f'the form "mine-v1", at most {_MAX_ID} of A-Z, a-z, 0-9, "_", "." and "-"'
        raise ValueError(f"name: expected {wanted}, got {show(name)}")
    if isinstance(scenes, str) or not isinstance(scenes, Sequence) or not scenes:
        raise ValueError("scenes: expected a sequence of at least one name, file or Scene")
    if name in _known() and not (name in _REGISTERED and (overwrite or _REGISTERED[name] == tuple(scenes))):
        hint = "with other scenes; say overwrite=True to replace them" if name in _REGISTERED else "by this package"
        raise ValueError(f"name: expected a free name, but {name} is registered {hint}")
    _REGISTERED[name] = tuple(scenes)


def make(
    id: str,  # as in gymnasium and gymnax
    *,
    protocol: str = "official",
    dtype: str = "float32",
    observation: ObservationName = "official",
    image_size: int | None = None,
    autoreset: bool = True,
    final_observation: bool = False,
    official_bugs: bool = False,
    limits: Limits | None = None,
    backend: BackendName | None = None,
) -> tuple[Environment, EnvParams]:
    """Return an environment and the parameters with its games.

    Args:
        id: "strategy/games-v1": a strategy ("in-advance", "on-the-fly", "combined") and a split, "all" (the forty), a
            game, or a name from `register`.
        protocol: "official", 10 physics steps a second in the second reset of a space, as for the paper's agents;
            "smooth", 60 steps a second in a fresh space, as for people. Decisions come every 0.1 s in both.
        dtype: of the physics, "float32" or "float64"; "float64" needs `jax.enable_x64(True)`.
        observation: "official", "motion" or "image"; see `Environment`.
        image_size: px, side of the images (with observation="image" only; 600 by default, as the official ones).
        autoreset: whether `step` begins the next episode when one ends.
        final_observation: whether `info["final_observation"]` has the observation before any reset; where infos are
            kept it takes as much memory as the observations.
        official_bugs: whether to reproduce bugs of the official code: the 151st frame of the combined strategy.
        limits: of all its scenes: rows of an observation and slots of an action; by default the smallest that hold the
            scenes' own limits.
        backend: "host", "xla", see `Environment`; by default "host" if JAX's default backend is a CPU, else "xla".

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    strategy, _, games = id.partition("/") if isinstance(id, str) else ("", "", "")
    sets = _known()
    if strategy not in STRATEGIES or games not in sets:
        close = get_close_matches(str(id)[:_MAX_ID], environment_ids(), n=3) if isinstance(id, str) else []
        hint = f"did you mean {' or '.join(close)}?" if close else 'they look like "in-advance/basic-v1"'
        raise ValueError(
            f"id: expected one of iphyre_jax.environment_ids(), see also register, got {show(id)} ({hint})"
        )
    return environment_of(
        id,
        load_scenes(sets[games], limits),
        strategy=strategy,
        protocol=protocol,
        dtype=dtype,
        observation=observation,
        image_size=image_size,
        autoreset=autoreset,
        final_observation=final_observation,
        official_bugs=official_bugs,
        backend=backend,
    )


def environment_of(
    name: str,
    scenes: Sequence[Scene],
    *,
    strategy: str,
    protocol: str | EpisodeProtocol,
    dtype: str,
    observation: ObservationName,
    image_size: int | None,
    autoreset: bool,
    final_observation: bool = False,
    official_bugs: bool = False,
    backend: BackendName | None = None,
) -> tuple[Environment, EnvParams]:
    """Return the environment of some scenes with the same limits; other arguments as for `make`.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    check_fork()
    dtype = check_dtype(dtype)
    check_option("observation", observation, get_args(ObservationName))
    if backend is not None and (not isinstance(backend, str) or backend not in get_args(BackendName)):
        raise ValueError(f"backend: expected one of {', '.join(get_args(BackendName))} or None, got {show(backend)}")
    for flag, value in (("autoreset", autoreset), ("final_observation", final_observation)):
        check_flag(flag, value)
    check_flag("official_bugs", official_bugs)
    chosen = protocol if isinstance(protocol, EpisodeProtocol) else protocol_named(protocol)
    limits = scenes[0].limits
    compiled = [cached_world(scene, chosen.resets, dtype) for scene in scenes]
    environment = Environment(
        name=name,
        games=tuple(scene.name for scene in scenes),
        strategy=strategy_named(strategy, official_bugs=official_bugs, slots=limits.blocks),
        protocol=chosen,
        topologies=shared_topologies(topology for topology, _ in compiled),
        dtype=dtype,
        observation=observation,
        image_size=_image_size(image_size, observation),
        autoreset=autoreset,
        final_observation=final_observation,
        limits=limits,
        backend=backend or ("host" if on_cpu() else "xla"),
    )
    return environment, environment.params_of(scenes)


def _image_size(size: int | None, observation: str) -> int:
    if observation != "image":
        if size is not None:
            raise ValueError('image_size: expected none without observation="image"')
        return 0
    if size is None:
        return int(SCREEN)
    return check_whole("image_size", size, 1, MAX_IMAGE, "px")
