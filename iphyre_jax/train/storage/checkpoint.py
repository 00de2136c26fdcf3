"""Checkpoints of a run: the whole state by orbax, under a manifest of SHA-256 sums that loading verifies.

orbax alone restores flipped bits silently. A checkpoint is a folder RUN/checkpoints/000120, named by its number of
updates. It gets its name only once everything in it is on the disk:

state/            the arrays (orbax)
manifest.json     format, updates, settings, versions; size and SHA-256 of every file of state/
manifest.sha256   SHA-256 of manifest.json
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np
import orbax.checkpoint as ocp

from iphyre_jax.provenance import versions
from iphyre_jax.train import trainer
from iphyre_jax.train.settings import old_names
from iphyre_jax.train.settings.codec import config_from_json
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.trainer import RunState

FOLDER: Final = "checkpoints"
FORMAT: Final = 2  # format 1 has the names of `old_names`
KEEP: Final = 2  # checkpoints of a run; older ones are not needed
STATE, MANIFEST, SUM = "state", "manifest.json", "manifest.sha256"


def save(run: Path, config: TrainConfig, state: RunState) -> Path:
    """Write a checkpoint of a run and remove all but the newest ones.

    A process that is killed here leaves earlier checkpoints untouched, and at most a folder whose name begins with a
    dot, which the next `save` removes.

    Returns:
        Its folder.
    """
    folder = run / FOLDER
    final = folder / f"{int(state.update):06d}"
    if final.exists():
        return final
    folder.mkdir(exist_ok=True)
    for left in folder.glob(".*"):
        shutil.rmtree(left)
    partial = folder / f".{final.name}"
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save((partial / STATE).absolute(), named_arrays(_storable(state)))
    _write_manifest(partial, config, int(state.update))
    partial.rename(final)
    _sync(folder)
    for old in names(run)[:-KEEP]:
        remove(run, old)
    return final


def remove(run: Path, name: str) -> None:
    """Remove a checkpoint; a half-removed one never has its name."""
    gone = run / FOLDER / f".{name}"
    (run / FOLDER / name).rename(gone)
    shutil.rmtree(gone)


def names(run: Path) -> list[str]:
    """The checkpoints of a run, oldest first."""
    return sorted(entry.name for entry in (run / FOLDER).glob("[0-9]*") if entry.is_dir())


def load(run: Path, config: TrainConfig, name: str | None = None, *, to_resume: bool = False) -> RunState:
    """The state that `save` wrote for a run with these settings.

    Args:
        run: its folder.
        config: its settings.
        name: of the checkpoint; the newest by default.
        to_resume: refuse a checkpoint from other versions of the packages that decide the bits.

    Raises:
        FileNotFoundError: one line; there is no such checkpoint.
        ValueError: one line; it is damaged, or belongs to other settings. The line names the last good one, if any.
    """
    there = names(run)
    chosen = name or (there[-1] if there else None)
    if chosen is None:
        raise FileNotFoundError(f"{run / FOLDER}: there is no checkpoint")
    if chosen not in there:
        raise FileNotFoundError(f"{run / FOLDER}: there is no checkpoint {chosen}, only {', '.join(there) or 'none'}")
    try:
        state = _load(run / FOLDER / chosen, config)
    except Exception as error:  # orbax raises many kinds
        raise ValueError(f"{run / FOLDER / chosen}: {_first_line(error)}; {_offer(run, config, chosen)}") from None
    if to_resume:
        _same_versions(run / FOLDER / chosen)
    return state


def _same_versions(path: Path) -> None:
    """Refuse to resume with other versions: the bits would differ from those of an uninterrupted run."""
    written, here = json.loads((path / MANIFEST).read_text("utf-8"))["versions"], versions()
    other = [f"{name} {version}" for name, version in here.items() if written.get(name) != version]
    if other:
        was = ", ".join(f"{name.split()[0]} {written.get(name.split()[0])}" for name in other)
        raise ValueError(f"{path}: written with {was}, here is {', '.join(other)}: it can be evaluated, not resumed")


def _offer(run: Path, config: TrainConfig, damaged: str) -> str:
    """Name the newest other checkpoint that is good."""
    for name in reversed(names(run)):
        if name == damaged:
            continue
        try:
            _load(run / FOLDER / name, config)
        except Exception:  # noqa: S112 - not good either, whatever the reason
            continue
        return f"the last good one is {name}: --checkpoint {name}"
    return "there is no other good one"


def _first_line(error: Exception) -> str:
    """The first line of an error."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _load(path: Path, config: TrainConfig) -> RunState:
    """Verify and read one checkpoint."""
    old = verify(path, config) == 1
    like = jax.eval_shape(lambda: _storable(trainer.start(config)))
    expected = named_arrays(like)
    with ocp.StandardCheckpointer() as checkpointer:
        stored = checkpointer.metadata((path / STATE).absolute()).item_metadata.tree
        stored_name = {old_names.array_path(name) if old else name: name for name in stored}
        # Compared before anything is read: orbax readers hang at a wrong shape.
        if _forms({name: stored[stored_name[name]] for name in stored_name}) != _forms(expected):
            raise ValueError("it holds other arrays than these settings have")
        targets = {stored_name[name]: leaf for name, leaf in expected.items()}
        arrays = checkpointer.restore((path / STATE).absolute(), targets)
    leaves = [arrays[stored_name[name]] for name in expected]
    restored: RunState = jax.tree.unflatten(jax.tree.structure(like), leaves)
    return restored._replace(
        key=jax.random.wrap_key_data(restored.key),
        update=np.asarray(restored.update),
        decisions=np.asarray(restored.decisions),
    )


def verify(path: Path, config: TrainConfig) -> int:
    """Refuse a checkpoint that differs by a byte from what was written, or is not of these settings.

    Returns:
        Its format.

    Raises:
        ValueError, OSError: one line.
    """
    manifest = path / MANIFEST
    for file in (manifest, path / SUM):
        if not file.is_file():
            raise ValueError(f"damaged: {file.name} is missing")
    if (path / SUM).read_bytes() != f"{_sum(manifest)}\n".encode():
        raise ValueError(f"damaged: {MANIFEST} does not have the SHA-256 sum of {SUM}")
    content = json.loads(manifest.read_text("utf-8"))
    written: int = content.get("format")
    if written not in (1, FORMAT):
        raise ValueError(f"expected format {FORMAT}, got {written!r}: written by another version")
    if config_from_json(content["settings"], manifest, old=written == 1) != config:  # newer settings have defaults
        raise ValueError("it belongs to other settings than config.json says")
    if content["update"] != int(path.name):
        raise ValueError(f"expected the checkpoint of {int(path.name)} updates, got that of {content['update']}")
    expected, found = content["files"], _files(path)
    for name in sorted({*expected, *found}):
        if name not in found:
            raise ValueError(f"damaged: {name} is missing")
        if name not in expected:
            raise ValueError(f"damaged: {name} was not written with it")
        size = (path / name).stat().st_size
        if size != expected[name]["size"]:
            raise ValueError(f"damaged: {name} has {size} bytes, not {expected[name]['size']}")
        if _sum(path / name) != expected[name]["sha256"]:
            raise ValueError(f"damaged: {name} does not have the SHA-256 sum of the manifest")
    return written


def _write_manifest(path: Path, config: TrainConfig, update: int) -> None:
    """Write what `verify` reads, and flush everything to the disk."""
    sums = {name: {"size": (path / name).stat().st_size, "sha256": _sum(path / name)} for name in _files(path)}
    content = {"format": FORMAT, "update": update, "settings": config.to_json(), "versions": versions(), "files": sums}
    (path / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (path / SUM).write_text(f"{_sum(path / MANIFEST)}\n", "utf-8")
    for entry in [*path.rglob("*"), path]:
        _sync(entry)


def _files(path: Path) -> list[str]:
    """The files of a checkpoint's state, as paths relative to the checkpoint."""
    return sorted(entry.relative_to(path).as_posix() for entry in (path / STATE).rglob("*") if not entry.is_dir())


def _sum(file: Path) -> str:
    """SHA-256 of a file."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _sync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


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
