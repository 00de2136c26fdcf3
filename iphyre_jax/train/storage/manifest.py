"""The manifest of a checkpoint: size and SHA-256 of every file of its state, verified before anything is read.

The sums detect damage, not malice: whoever can write the state can write a manifest that fits.
"""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, Final

from iphyre_jax.checks import show
from iphyre_jax.files import MAX_JSON, file_sum, read_json_object
from iphyre_jax.provenance import versions
from iphyre_jax.train.settings.codec import config_from_json
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.named_files import with_own_scenes, without_paths

FORMAT: Final = 3  # format 1 has the names of `old_names`; to 2, replay buffers kept rows of episodes that had ended
STATE, MANIFEST, SUM = "state", "manifest.json", "manifest.sha256"
MAX_FILES: Final = 10_000  # of a state; orbax writes about twenty
SLACK: Final = 64 * 2**20  # bytes of a state beyond those of its arrays


def write(path: Path, config: TrainConfig, update: int) -> None:
    """Write what `verify` reads, and flush everything to the disk."""
    sums = {name: {"size": (path / name).stat().st_size, "sha256": file_sum(path / name)} for name in _files(path)}
    content = {"format": FORMAT, "update": update, "settings": config.to_json(), "versions": versions(), "files": sums}
    (path / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (path / SUM).write_text(f"{file_sum(path / MANIFEST)}\n", "utf-8")
    for entry in [*path.rglob("*"), path]:
        sync(entry)


def verify(path: Path, config: TrainConfig, state_bytes: int) -> int:
    """Refuse a checkpoint that differs by a byte from what was written, or is not of these settings.

    Args:
        path: of the checkpoint.
        config: settings of its run.
        state_bytes: of the arrays that these settings have; a state much larger is not read.

    Returns:
        Its format.

    Raises:
        ValueError, OSError: one line.
    """
    manifest = path / MANIFEST
    for file in (manifest, path / SUM):
        if not file.is_file():
            raise ValueError(f"damaged: {file.name} is missing")
        if file.stat().st_size > MAX_JSON:
            raise ValueError(f"damaged: {file.name}: expected at most {MAX_JSON} bytes, got {file.stat().st_size}")
    if (path / SUM).read_bytes() != f"{file_sum(manifest)}\n".encode():
        raise ValueError(f"damaged: {MANIFEST} does not have the SHA-256 sum of {SUM}")
    content = read(path)
    written = content["format"]
    if written not in range(1, FORMAT + 1):
        raise ValueError(f"expected format {FORMAT}, got {show(written)}: written by another version")
    settings = with_own_scenes(path.parents[1], content["settings"])
    of = config_from_json(settings, manifest, old=written == 1)  # newer settings have defaults
    if without_paths(of) != without_paths(config):
        raise ValueError("it belongs to other settings than config.json says")
    if content["update"] != int(path.name):
        raise ValueError(f"expected the checkpoint of {int(path.name)} updates, got that of {show(content['update'])}")
    _verify_files(path, content["files"], state_bytes + SLACK)
    return int(written)


def read(path: Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Raises:
        ValueError, OSError: one line; it is not such a file.
    """
    content = read_json_object(path / MANIFEST)
    for name, kind in (("format", int), ("update", int), ("settings", dict), ("versions", dict), ("files", dict)):
        if name != "format" and not isinstance(content.get(name), kind):
            raise ValueError(f"{MANIFEST}: {name}: expected {kind.__name__}, got {show(content.get(name))}")
    return {"format": None, **content}


def _verify_files(path: Path, expected: dict[str, Any], max_bytes: int) -> None:
    """Compare the files of a state with those of the manifest: names, then sizes, then sums."""
    found = _files(path)
    for name in sorted({*expected, *found}):
        if name not in found:
            raise ValueError(f"damaged: {name} is missing")
        if name not in expected:
            raise ValueError(f"damaged: {name} was not written with it")
        entry, about = expected[name], (path / name).lstat()
        if not isinstance(entry, dict) or not {"size", "sha256"} <= entry.keys():
            raise ValueError(f"{MANIFEST}: files: {show(name)}: expected size and sha256, got {show(entry)}")
        if not stat.S_ISREG(about.st_mode):  # a pipe would be read for ever
            raise ValueError(f"damaged: {name} is no plain file")
        if about.st_size != entry["size"]:
            raise ValueError(f"damaged: {name} has {about.st_size} bytes, not {show(entry['size'])}")
        max_bytes -= about.st_size
        if max_bytes < 0:
            raise ValueError(f"damaged: the files of {STATE}/ are larger than the arrays of these settings")
    for name in sorted(found):
        if file_sum(path / name) != expected[name]["sha256"]:
            raise ValueError(f"damaged: {name} does not have the SHA-256 sum of the manifest")


def _files(path: Path) -> list[str]:
    """The files of a checkpoint's state, as paths relative to the checkpoint."""
    names = []
    for entry in (path / STATE).rglob("*"):
        if not entry.is_dir():
            names.append(entry.relative_to(path).as_posix())
        if len(names) > MAX_FILES:
            raise ValueError(f"damaged: {STATE}/ has more than {MAX_FILES} files")
    return sorted(names)


def sync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
