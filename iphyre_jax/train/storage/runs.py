"""Run folders: what a training run writes, and how it is read again.

config.json       settings, versions, device, commit
scenes/           copies of the scene files among the games (`named_files.py`)
metrics.csv       one line an update, written at once
checkpoints/      states of the run, the newest two (`checkpoint.py`)
curve.png         learning curve
evaluation.json   and evaluation.md: the trained policy's games
ensemble.json     and ensemble.md: those of an ensemble of this run and others
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Final

from iphyre_jax.checks import show
from iphyre_jax.data.dataset import scene_sum
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.files import read_json_object, replace_bytes, replace_json, replace_text
from iphyre_jax.locks import LOCK
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import load_scene
from iphyre_jax.train.evaluate import Evaluation
from iphyre_jax.train.reports.report import markdown
from iphyre_jax.train.settings.codec import config_from_json
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, logs
from iphyre_jax.train.storage.named_files import copy_scenes, scene_sums, with_own_scenes, with_present_files
from iphyre_jax.train.trainer import RunState

SCHEMA: Final = "iphyre_jax/run"
VERSION: Final = 3  # version 2 has the names of `old_names`
CONFIG, EVALUATION, OF_ENSEMBLE = "config.json", "evaluation.json", "ensemble.json"
SCENES: Final = "scenes_sha256"  # in config.json, of the scene files among the games
PUBLISHED: Final = (CONFIG, logs.FILE, EVALUATION)  # of an evaluated run; scores last, for they say that it is whole


def new_folder(config: TrainConfig, root: Path = Path("runs")) -> Path:
    """Make a folder for a run, named after it and the time, with a number if another run has that name.

    Raises:
        OSError: it cannot be made.
    """
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    trained_on = "some-games" if config.games else config.split
    name = f"{config.agent}-{config.strategy}-{config.head}-{trained_on}-{config.fps}fps-seed{config.seed}-{stamp}"
    root.mkdir(parents=True, exist_ok=True)
    folder, number = root / name, 1
    while True:
        try:
            folder.mkdir()  # one process makes it
        except FileExistsError:
            number += 1
            folder = root / f"{name}-{number}"
        else:
            return folder


def make_folder(path: Path) -> None:
    """Make the folder of a new run.

    Raises:
        ValueError: one line; the path exists and is not an empty folder.
    """
    if path.exists() and (not path.is_dir() or any(entry.name != LOCK for entry in path.iterdir())):
        raise ValueError(f"{path}: expected a new or empty folder for the run")
    path.mkdir(parents=True, exist_ok=True)


def create(path: Path, config: TrainConfig) -> None:
    """Make a run folder and write its config.json.

    Raises:
        ValueError: one line; a setting cannot work, or the path exists and is not an empty folder.
    """
    config.check()
    make_folder(path)
    content = {"schema": SCHEMA, "version": VERSION, "agent": config.agent_name, "settings": config.to_json()}
    started = datetime.now().astimezone().isoformat(timespec="seconds")
    replace_json(path / CONFIG, {**content, SCENES: scene_sums(config), "started": started, **provenance()})
    copy_scenes(path, config)  # after that file: a run that is killed here can be resumed


def scene_sums_of(path: Path) -> tuple[str, ...]:
    """The sums of the scene files that a run began with, sorted: wherever the files lay."""
    written = read_json_object(path / CONFIG).get(SCENES)
    return tuple(sorted(map(str, written.values()))) if isinstance(written, dict) else ()


def check_scenes(path: Path, config: TrainConfig) -> None:
    """Refuse to go on with other scenes than a run began with.

    Raises:
        ValueError, OSError: one line; a scene file among the games was changed, or is gone.
    """
    content = read_json_object(path / CONFIG)
    begun, named = content.get(SCENES), content["settings"].get("games", ())  # sums, by the paths that they began with
    for name, file in zip(named, config.games, strict=True):
        if isinstance(begun, dict) and name in begun and begun[name] != scene_sum(load_scene(file)):
            raise ValueError(f"games: expected the scene that the run began with, but {file} was changed")


def other_machine(path: Path) -> str:
    """Say in one line how this machine differs from that on which a run began; empty if it does not.

    How many cores share out a sum decides how it rounds.
    """
    written, here = read_json_object(path / CONFIG), provenance()
    parts = [name for name in ("device", "machine") if written.get(name, here[name]) != here[name]]
    changes = "; ".join(f"{show(written[name])}, here {show(here[name])}" for name in parts)
    return f"begun on {changes}: the bits may differ from those of a run without a stop" if parts else ""


def publish(path: Path, published: Path) -> None:
    """Copy settings, log and scores of an evaluated run to a folder.

    Raises:
        OSError: a file cannot be read or written.
    """
    published.mkdir(parents=True, exist_ok=True)
    for name in PUBLISHED:
        replace_bytes(published / name, (path / name).read_bytes())


def read_config(path: Path) -> TrainConfig:
    """The settings of a run, with the paths of the files that it names where they are now (`named_files`).

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    file = path / CONFIG
    if not file.is_file():
        raise FileNotFoundError(f"{path}: not a run folder, there is no {CONFIG}")
    content = read_json_object(file)
    if content.get("schema") != SCHEMA:
        raise ValueError(f'{file}: schema: expected "{SCHEMA}"')
    if content.get("version") not in (2, VERSION):
        raise ValueError(f"{file}: version: expected {VERSION}, got {show(content.get('version'))}")
    settings = with_own_scenes(path, content.get("settings"))
    return with_present_files(path, config_from_json(settings, file, old=content["version"] == 2))


@default_options()
def load(path: Path, name: str | None = None, *, to_resume: bool = False) -> tuple[TrainConfig, RunState]:
    """Settings and state of a finished or interrupted run; see `checkpoint.load`.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    config = read_config(path)
    return config, checkpoint.load(path, config, name, to_resume=to_resume)


def write_evaluation(
    path: Path, config: TrainConfig, evaluation: Evaluation, updates: int, ensemble: Sequence[str] = ()
) -> None:
    """Write evaluation.json and evaluation.md into a run folder; of an ensemble, ensemble.json and ensemble.md.

    Args:
        path: of the folder.
        config: of the run.
        evaluation: of the policy.
        updates: that the policy was trained for.
        ensemble: the folders of its runs.
    """
    file = path / (OF_ENSEMBLE if ensemble else EVALUATION)
    facts = {
        **({"ensemble of": ", ".join(ensemble)} if ensemble else {}),
        "updates trained": f"{updates} of {config.updates}, {updates * config.episodes_per_update} episodes",
        **provenance(),
    }
    content = {"agent": config.agent_name, "settings": config.to_json(), **facts, **evaluation.to_json()}
    replace_text(file.with_suffix(".md"), markdown(evaluation, config, facts))
    replace_json(file, content)
