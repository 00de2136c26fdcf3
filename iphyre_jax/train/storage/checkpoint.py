"""Checkpoints of a run: the whole state by orbax, under a manifest of SHA-256 sums that loading verifies.

orbax alone restores flipped bits silently. A checkpoint is a folder RUN/checkpoints/000120, named by its number of
updates. It gets its name only once everything in it is on the disk:

state/            the arrays (orbax)
manifest.json     format, updates, settings, versions; size and SHA-256 of every file of state/
manifest.sha256   SHA-256 of manifest.json
"""

from __future__ import annotations

import logging
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np
import orbax.checkpoint as ocp

from iphyre_jax.checks import one_line, show
from iphyre_jax.provenance import versions
from iphyre_jax.train import trainer
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.settings import old_names
from iphyre_jax.train.settings.agents import OffPolicy
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import manifest
from iphyre_jax.train.storage.manifest import STATE
from iphyre_jax.train.storage.named_files import scene_sums
from iphyre_jax.train.trainer import RunState

FOLDER: Final = "checkpoints"
KEEP: Final = 2  # checkpoints of a run; older ones are not needed
ROOM: Final = 2**20  # bytes of a checkpoint beyond those of its arrays
# Else threads wait twenty minutes for a folder that could not be made, and the process with them.
FOLDERS_FIRST: Final = ocp.AsyncOptions(create_directories_asynchronously=False)
MAX_NAMED: Final = 5  # checkpoints in a message
MAX_MESSAGE: Final = 300  # characters of orbax's, which names files at length


def save(run: Path, config: TrainConfig, state: RunState) -> Path:
    """Write a checkpoint of a run and remove all but the newest ones.

    A process that is killed here leaves earlier checkpoints untouched, and at most a folder whose name has a dot in
    front of the number, which the next `save` removes.

    Returns:
        Its folder.

    Raises:
        OSError: one line; it cannot be written. Earlier checkpoints are untouched.
    """
    folder = run / FOLDER
    final = folder / f"{int(state.update):06d}"
    partial = folder / f".{final.name}"
    if final.exists():
        return final
    arrays = named_arrays(_storable(state))
    try:
        folder.mkdir(exist_ok=True)
        for left in folder.glob(".[0-9]*"):  # no other program's: a file manager leaves hidden files too
            shutil.rmtree(left)
        _require_room(folder, arrays)
        with _quiet(), ocp.StandardCheckpointer(async_options=FOLDERS_FIRST) as checkpointer:
            checkpointer.save((partial / STATE).absolute(), arrays)
        manifest.write(partial, config, int(state.update))
        partial.rename(final)
        manifest.sync(folder)
        for old in names(run)[:-KEEP]:
            remove(run, old)
    except Exception as error:  # orbax raises many kinds
        shutil.rmtree(partial, ignore_errors=True)
        raise OSError(f"{final}: the checkpoint cannot be written: {_first_line(error)}") from error
    return final


def _require_room(folder: Path, arrays: Mapping[str, Any]) -> None:
    """Refuse to begin a checkpoint that the disk has no room for."""
    free, needed = shutil.disk_usage(folder).free, _bytes(arrays) + ROOM
    if free < needed:
        raise OSError(f"expected {needed / 1e6:,.1f} MB of room on the disk, got {free / 1e6:,.1f} MB")


def _bytes(arrays: Mapping[str, Any]) -> int:
    """Bytes of all arrays together."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in arrays.values())


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep orbax from logging the trace of an error that we raise in one line."""
    loggers = [logging.getLogger(name) for name in ("absl", "asyncio")]
    before = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, disabled in zip(loggers, before, strict=True):
            logger.disabled = disabled


def remove(run: Path, name: str) -> None:
    """Remove a checkpoint; a half-removed one never has its name."""
    gone = run / FOLDER / f".{name}"
    shutil.rmtree(gone, ignore_errors=True)  # left by a kill
    (run / FOLDER / name).rename(gone)
    shutil.rmtree(gone)


def names(run: Path) -> list[str]:
    """The checkpoints of a run, oldest first: by number, for a millionth update has a longer name."""
    found = [entry.name for entry in (run / FOLDER).glob("[0-9]*") if entry.name.isdecimal() and entry.is_dir()]
    return sorted(found, key=lambda name: (int(name), name))


def load(run: Path, config: TrainConfig, name: str | None = None, *, to_resume: bool = False) -> RunState:
    """The state that `save` wrote for a run with these settings, or what of it plays.

    Args:
        run: its folder.
        config: its settings.
        name: of the checkpoint; the newest by default.
        to_resume: read what only learning needs too, and refuse a checkpoint from other versions of the packages that
            decide the bits.

    Raises:
        FileNotFoundError: one line; there is no such checkpoint, or no scene file among the games.
        ValueError: one line; it is damaged, or belongs to other settings. The line names the last good one, if any.
    """
    there = names(run)
    chosen = name or (there[-1] if there else None)
    if chosen is None:
        raise FileNotFoundError(f"{run / FOLDER}: there is no checkpoint")
    if chosen not in there:
        known = ", ".join(there[-MAX_NAMED:]) or "none"
        raise FileNotFoundError(f"{run / FOLDER}: there is no checkpoint {show(chosen)}, only {known}")
    scene_sums(config)  # a scene that is gone is no fault of the checkpoint
    try:
        state = _load(run / FOLDER / chosen, config, whole=to_resume)
    except Exception as error:  # orbax raises many kinds
        raise ValueError(
            f"{run / FOLDER / chosen}: {_first_line(error)}; {_offer(run, config, chosen, to_resume)}"
        ) from None
    if to_resume:
        _same_versions(run / FOLDER / chosen)
    return state


def _same_versions(path: Path) -> None:
    """Refuse to resume with other versions: the bits would differ from those of an uninterrupted run."""
    written, here = manifest.read(path)["versions"], versions()
    other = [f"{name} {version}" for name, version in here.items() if written.get(name) != version]
    if other:
        was = ", ".join(f"{name.split()[0]} {written.get(name.split()[0])}" for name in other)
        raise ValueError(f"{path}: written with {was}, here is {', '.join(other)}: it can be evaluated, not resumed")


def _offer(run: Path, config: TrainConfig, damaged: str, to_resume: bool) -> str:
    """Name the newest other checkpoint that is good."""
    for name in reversed(names(run)):
        if name == damaged:
            continue
        try:
            _load(run / FOLDER / name, config, whole=to_resume)
        except Exception:  # noqa: S112 - not good either, whatever the reason
            continue
        return f"the last good one is {name}: --checkpoint {name}"
    return "there is no other good one"


def _first_line(error: Exception) -> str:
    """The first line of an error, or what the system says of it: orbax gives a number at the end of a long line."""
    if number := re.search(r"os_error_code='?([0-9]+)", str(error)):
        return os.strerror(int(number[1]))
    return one_line((str(error).strip().splitlines() or [type(error).__name__])[0])[:MAX_MESSAGE]


def _load(path: Path, config: TrainConfig, *, whole: bool) -> RunState:
    """Verify one checkpoint, and read all of it or what plays."""
    like = jax.eval_shape(lambda: _storable(trainer.start(config)))
    written = manifest.verify(path, config, _bytes(named_arrays(like)))
    if written < manifest.FORMAT:
        _check_older(config, whole)
    if not whole:
        like = like._replace(learner=algorithm(config).inference_state(like.learner))
    expected = named_arrays(like)
    with _quiet(), ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as checkpointer:
        stored = checkpointer.metadata((path / STATE).absolute()).item_metadata.tree
        stored_name = {old_names.array_path(name) if written == 1 else name: name for name in stored}
        # Compared before anything is read: orbax readers hang at a wrong shape.
        forms = _forms({name: stored[stored_name[name]] for name in stored_name if whole or name in expected})
        if forms != _forms(expected):
            raise ValueError("it holds other arrays than these settings have")
        targets = {stored_name[name]: leaf for name, leaf in expected.items()}
        restore_args = ocp.checkpoint_utils.construct_restore_args(targets)
        asked = ocp.args.PyTreeRestore(targets, restore_args, partial_restore=True)
        arrays = checkpointer.restore((path / STATE).absolute(), asked)
    leaves = jax.device_put([arrays[stored_name[name]] for name in expected])
    restored: RunState = jax.tree.unflatten(jax.tree.structure(like), leaves)
    if int(restored.update) != int(path.name):
        raise ValueError(f"damaged: its state is that of {int(restored.update)} updates")
    return restored._replace(
        key=jax.random.wrap_key_data(restored.key),
        update=np.asarray(restored.update),
        decisions=np.asarray(restored.decisions),
        curriculum=jax.tree.map(np.asarray, restored.curriculum),
    )


def _check_older(config: TrainConfig, whole: bool) -> None:
    """Refuse what checkpoints of older formats cannot give to runs of today."""
    if config.head == "uniform" and config.agent != "random":
        raise ValueError('its head "uniform" offered no slots without a block: it cannot be played on')
    if whole and isinstance(config.learner, OffPolicy):
        raise ValueError("its replay buffer is of an older form: it can be evaluated, not resumed")


def _storable(state: RunState) -> RunState:
    """The state with its random key as plain integers."""
    return state._replace(key=jax.random.key_data(state.key))


def named_arrays(state: Any) -> dict[str, Any]:  # noqa: ANN401 - any tree of arrays
    """Every array of a state by its path, "learner.params.policy..." and so on, in order."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def _forms(named: Mapping[str, Any]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and dtype of each array."""
    return {name: (tuple(leaf.shape), str(leaf.dtype)) for name, leaf in named.items()}
