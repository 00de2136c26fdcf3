"""Part of `make test-faults`: files that somebody made to do harm; each is refused in one line, fast, in little memory.

Weights, run folders, checkpoints, evaluations, logs, scenes and plays: too deep, too long, empty, binary, lying about
their sizes, with fields of other kinds. All sums of SHA-256 fit, for whoever makes such a file makes its sums too.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import resource
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from record import record

from iphyre_jax import load_scene
from iphyre_jax.cli import main as cli
from iphyre_jax.files import file_sum
from iphyre_jax.train import trainer
from iphyre_jax.train.reports import compare, curve
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, logs, manifest, runs
from iphyre_jax.train.storage.pretrained import load_pretrained, rounded, save_pretrained
from tests.test_files import BAD as ARCHIVES

SECONDS = 2.0  # of processor time, for each file
BYTES = 1e9  # of memory, for each file
CONFIG = TrainConfig(games=("support", "hole"), hidden_sizes=(16,), learner=PPO(minibatches=2))
COLUMNS = ("update", "episodes", "reward", "decisions", "greedy_reward")

Case = tuple[str, Path, Callable[[], object]]  # name, the file that the line must name, reading it

JSON = {
    "empty": b"",
    "deep lists": b"[" * 100_000,
    "deep lists, closed": b"[" * 100_000 + b"]" * 100_000,
    "deep objects": b'{"a":' * 50_000,
    "binary": bytes(range(128, 256)),
    "byte order mark": b"\xef\xbb\xbf{}",
    "cut": b'{"schema": "iphyre',
    "repeated": b'{"schema": 1, "schema": 1}',
    "many digits": b'{"schema": ' + b"9" * 10_000 + b"}",
    "many lists": b"[" + b"[]," * 3_000_000 + b"[]]",
    "long": b'{"schema": "' + b"a" * 12_000_000 + b'"}',
    "a list": b"[1]",
    "null": b"null",
}
FIELDS = {  # of a run's settings
    "deep": json.loads("[" * 400 + "]" * 400),
    "text": "x" * 1_000_000,
    "infinite": float("inf"),
    "large": 10**4000,
    "null": None,
    "object": {"a": 1},
}
LINES = {  # metrics.csv
    "foreign columns": "time,loss\n1,2\n",
    "no columns": "\n1\n",
    "column twice": "update,update,episodes,reward,decisions,greedy_reward\n1,1,1,1,1,1\n",
    "few cells": "HEADER\n1,2\n",
    "many cells": "HEADER\n" + ",".join("1" * 50) + "\n",
    "no number": "HEADER\n1,one,1,1,1\n",
    "no update": "HEADER\nsoon,1,1,1,1\n",
    "large update": "HEADER\n" + "9" * 9000 + ",1,1,1,1\n",
    "quote": 'HEADER\n1,"1,1,1,1\n',
    "long line": "HEADER\n" + "1" * 50_000_000,
    "not text": "HEADER\n1,\udcff,1,1,1\n",
}


def archives(root: Path) -> Iterator[Case]:
    """NAME.npz."""
    state = rounded(CONFIG, trainer.start(CONFIG).learner)
    for name, (raw, _) in ARCHIVES.items():
        folder = root / name.replace(" ", "-")
        save_pretrained("one", CONFIG, state, {"splits": {}, "games": [], "faults": 0}, {}, folder)
        file = folder / "one.json"
        (folder / "one.npz").write_bytes(raw)
        file.write_text(json.dumps({**json.loads(file.read_text()), "sha256": hashlib.sha256(raw).hexdigest()}))
        yield f"weights, {name}", folder / "one.npz", lambda folder=folder: load_pretrained("one", folder)


def documents(root: Path) -> Iterator[Case]:
    """Every JSON file that a reader of ours opens."""
    for name, raw in JSON.items():
        folder = root / name.replace(" ", "-").replace(",", "")
        folder.mkdir(parents=True)
        for file in ("config.json", "scene.json", "one.json", "one.npz"):
            (folder / file).write_bytes(raw)
        yield f"settings, {name}", folder / "config.json", lambda folder=folder: runs.read_config(folder)
        yield f"scene, {name}", folder / "scene.json", lambda folder=folder: load_scene(folder / "scene.json")
        yield f"description, {name}", folder / "one.json", lambda folder=folder: load_pretrained("one", folder)
        run = root / f"{folder.name}-run"
        runs.create(run, CONFIG)
        (run / runs.EVALUATION).write_bytes(raw)
        yield f"evaluation, {name}", run / runs.EVALUATION, lambda run=run: compare.read(run)
        path = damaged_checkpoint(root / f"{folder.name}-checkpoint")
        (path / manifest.MANIFEST).write_bytes(raw)
        seal(path)
        yield f"manifest, {name}", path, lambda path=path: runs.load(path.parents[1])


def fields(root: Path) -> Iterator[Case]:
    """config.json with one setting of another kind, or one that asks for too much."""
    settings = CONFIG.to_json()
    changes: dict[str, Any] = {f"{name} {kind}": {name: v} for name in settings for kind, v in FIELDS.items()}
    del changes["scene_pool text"]  # any text may name a file, which is opened when the run goes on
    changes |= {"wide": {"hidden_sizes": [10**9] * 9}, "a file": {"games": ["/dev/zero"]}, "nul": {"games": ["\0"]}}
    changes |= {"surrogate": {"games": ["\ud800"]}, "buffer": {"learner": {"minibatches": 10**12}}}
    for name, change in changes.items():
        run = root / name.replace(" ", "-")
        runs.create(run, CONFIG)
        content = json.loads((run / runs.CONFIG).read_text())
        with contextlib.suppress(ValueError):  # too many digits for Python to write
            (run / runs.CONFIG).write_text(json.dumps({**content, "settings": {**settings, **change}}))
            yield f"setting, {name}", run / runs.CONFIG, lambda run=run: runs.read_config(run)


def tables(root: Path) -> Iterator[Case]:
    """metrics.csv, as it is continued and as it is drawn."""
    for name, text in LINES.items():
        run = root / name.replace(" ", "-")
        run.mkdir(parents=True)
        text = text.replace("HEADER", ",".join(COLUMNS))
        (run / logs.FILE).write_bytes(text.encode("utf-8", "surrogateescape"))
        yield f"log, {name}", run / logs.FILE, lambda run=run: logs.Log(run, COLUMNS, 10**9, tensorboard=False)
        yield f"curve, {name}", run / logs.FILE, lambda run=run: curve.draw_curve(run, CONFIG)


def damaged_checkpoint(run: Path) -> Path:
    """A run with one good checkpoint, for damage; returns the checkpoint."""
    runs.create(run, CONFIG)
    return checkpoint.save(run, CONFIG, trainer.start(CONFIG)._replace(update=np.asarray(1, np.int32)))


def seal(path: Path, **changes: object) -> None:
    """Let the sums of a checkpoint fit what is there."""
    file = path / manifest.MANIFEST
    if changes:
        file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))
    (path / manifest.SUM).write_text(f"{file_sum(file)}\n")


def checkpoints(root: Path) -> Iterator[Case]:
    """Checkpoints whose manifest fits and whose state does not: cut, foreign, of another shape, no plain files."""

    def case(name: str, path: Path) -> Case:
        files = {f: {"size": (path / f).stat().st_size, "sha256": file_sum(path / f)} for f in state_files(path)}
        seal(path, files=files)
        return f"checkpoint, {name}", path, lambda: runs.load(path.parents[1])

    good = damaged_checkpoint(root / "good")
    for k, name in enumerate(filter(is_read, state_files(good))):
        for kind, length in (("emptied", 0), ("cut", (good / name).stat().st_size // 2)):
            run = Path(shutil.copytree(root / "good", root / f"{kind}-{k}"))
            os.truncate(run / checkpoint.FOLDER / good.name / name, length)
            yield case(f"{name} {kind}", run / checkpoint.FOLDER / good.name)
    other = CONFIG.to_json() | {"hidden_sizes": [17]}
    run = Path(shutil.copytree(root / "good", root / "shape"))
    (run / runs.CONFIG).write_text((run / runs.CONFIG).read_text().replace("16\n", "17\n"))
    seal(run / checkpoint.FOLDER / good.name, settings=other)
    yield "checkpoint, other shape", run / checkpoint.FOLDER / good.name, lambda: runs.load(run)
    pipe = damaged_checkpoint(root / "pipe")
    os.mkfifo(pipe / manifest.STATE / "pipe")
    seal(
        pipe,
        files={**json.loads((pipe / manifest.MANIFEST).read_text())["files"], "state/pipe": {"size": 0, "sha256": ""}},
    )
    yield "checkpoint, pipe", pipe, lambda: runs.load(pipe.parents[1])


def state_files(path: Path) -> list[str]:
    """The files of a state."""
    return sorted(f.relative_to(path).as_posix() for f in (path / manifest.STATE).rglob("*") if f.is_file())


def is_read(name: str) -> bool:
    """Whether loading reads this file of a state; orbax writes others, which it does not need again."""
    return name.startswith(("state/d/", "state/_METADATA", "state/manifest.ocdbt"))


def plays(root: Path) -> Iterator[Case]:
    """Files of plays, by the command that reads them."""
    root.mkdir(parents=True)
    for name, raw in JSON.items():
        file = root / f"{name.replace(' ', '-')}.jsonl"
        file.write_bytes(raw)
        yield f"plays, {name}", file, lambda file=file: command(["score", str(file)])


def command(arguments: list[str]) -> None:
    """Run a command; its mistake becomes an error."""
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(io.StringIO()):
        code = cli.run(arguments)
    if code == cli.ERROR:
        raise ValueError(said.getvalue().rstrip("\n"))


def refused(case: Case) -> bool:
    """Whether a file is refused in one line that names it, in time and memory; says what is wrong if not."""
    name, file, read = case
    begun, before = time.process_time(), resident()
    try:
        read()
        said = None
    except (ValueError, OSError) as error:
        said = str(error)
    except Exception:
        said = traceback.format_exc()
    took, grown = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before
    fine = said is not None and "\n" not in said and str(file) in said and took < SECONDS and grown < BYTES
    if not fine:
        print(f"{name}: {took:.1f} s, {grown / 1e6:.0f} MB: {said if said is None else said[:2000]}", flush=True)
    return fine


def resident() -> float:
    """Bytes of memory that this process has."""
    return float(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def main() -> int:
    """Make each file, read it; 0 if all were refused."""
    root, begun = Path("build/test-hostile-files").absolute(), time.monotonic()
    shutil.rmtree(root, ignore_errors=True)
    runs.load(damaged_checkpoint(root / "good").parents[1])  # what a process does once only
    kinds = (archives, documents, fields, tables, checkpoints, plays)
    found = [refused(case) for kind in kinds for case in kind(root / kind.__name__)]
    promise = "a hostile file is refused in one line, within 2 s of processor time and 1 GB"
    record("hostile-files", promise, len(found), sum(found), 0, time.monotonic() - begun)
    return 0 if all(found) else 1


if __name__ == "__main__":
    sys.exit(main())
