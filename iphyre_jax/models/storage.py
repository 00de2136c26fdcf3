"""What all kinds of models share in files: run folders, and the pairs of files of trained models.

A run folder has config.json (settings, what is learned from, versions, machine, commit), state.npz (the whole state
after the last chunk; whole at any moment), metrics.csv and evaluation.json. A trained model is NAME.npz with its
parameters, and NAME.json with the sum of the former.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import show
from iphyre_jax.files import pack_npz, read_json_object, read_npz, read_versioned, replace_bytes, replace_json
from iphyre_jax.memory import forget_programs
from iphyre_jax.models.settings import S, settings_of
from iphyre_jax.provenance import differences, provenance
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.runs import publish
from iphyre_jax.train.storage.weights import restored, verify_sum

VERSION: Final = 1
CONFIG, STATE, METRICS, EVALUATION = "config.json", "state.npz", "metrics.csv", "evaluation.json"
MAX_BYTES: Final = 2**30  # of an .npz file
BEST: Final = "best"  # folder of the best seed of a row, as it ships, in its run folder

Params = Any  # a network's tree of arrays


@dataclass(frozen=True)
class Comparison:
    """Where the rows of a document are trained, and what of them is kept.

    Attributes:
        root: folder of the run folders and of the data sets.
        out: the document.
        weights: folder for the best model of each row that ships; None to ship nothing.
    """

    root: Path
    out: Path
    weights: Path | None = None

    @property
    def published(self) -> Path:
        """Folder of what is published of each run, beside the document; a run that is there is not trained again."""
        return self.out.parent / "models" / self.out.stem


@dataclass(frozen=True)
class RunFolders(Generic[S]):
    """The run folders of one kind of model.

    Attributes:
        schema: of config.json and evaluation.json.
        kind: class of the settings.
        measures: version of what an evaluation measures; one of another version is made anew.
    """

    schema: str
    kind: type[S]
    measures: int = 1

    def create(self, folder: Path, config: S, **learned: object) -> None:
        """Begin a run folder, or find the same run in it.

        Args:
            folder: of the run.
            config: settings.
            **learned: what else decides the run, JSON values; older runs may lack some.

        Raises:
            ValueError: one line; the folder holds another run.
        """
        config.check()
        found = {"settings": config.to_json(), **learned}
        if (folder / CONFIG).is_file():
            content = read_json_object(folder / CONFIG)
            for field, value in found.items():
                if content.get(field, value if field in learned else None) != value:
                    other = differences({field: content.get(field)}, {field: value})
                    raise ValueError(f"{folder / CONFIG}: {field}: expected those of this run, got {other}; remove it")
            return
        folder.mkdir(parents=True, exist_ok=True)
        replace_json(folder / CONFIG, {"schema": self.schema, "version": VERSION, **found, **provenance()})

    def read_config(self, folder: Path) -> S:
        """The settings of a run.

        Raises:
            FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
        """
        file = folder / CONFIG
        if not file.is_file():
            raise FileNotFoundError(f"{folder}: not a run folder, there is no {CONFIG}")
        return settings_of(self.kind, read_versioned(file, self.schema, (VERSION,)).get("settings"), str(file))

    def read_published(self, folder: Path, config: S) -> dict[str, Any] | None:
        """The evaluation of a run with these settings that `runs.publish` put into a folder.

        None if there is none, or one of other measures.

        Raises:
            ValueError: one line naming the file and what is wrong with it.
        """
        if not (folder / EVALUATION).is_file():
            return None
        found = self.read_evaluation(folder)
        wanted = {"settings": config.to_json(), "measures": self.measures}
        return found if {"measures": 1, **found}.items() >= wanted.items() else None

    def published_row(self, where: Comparison, config: S, make: Callable[[], object]) -> dict[str, Any]:
        """The evaluation of a run with these settings that is published; if there is none yet, make and publish it.

        Args:
            where: folders.
            config: settings.
            make: trains and evaluates the run in its folder, or what is left of that.

        Raises:
            ValueError, OSError: one line naming the file and what is wrong with it, or what `make` raises.
        """
        published = where.published / config.name
        if (known := self.read_published(published, config)) is not None:
            return known
        make()
        publish(where.root / config.name, published)
        forget_programs()
        return self.read_evaluation(published)

    def read_evaluation(self, folder: Path, **fields: type) -> dict[str, Any]:
        """The evaluation of a run.

        Args:
            folder: of the run.
            **fields: kinds of the values that the caller reads.

        Raises:
            FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
        """
        file = folder / EVALUATION
        if not file.is_file():
            self.read_config(folder)  # which tells what is no run folder
            raise FileNotFoundError(f"{folder}: expected a run trained to its end, but there is no {EVALUATION}")
        content = read_versioned(file, self.schema, (VERSION,))
        for field, kind in fields.items():
            if not isinstance(content.get(field), kind):
                raise ValueError(f"{file}: {field}: expected a {kind.__name__}, got {show(content.get(field))}")
        return content


@dataclass(frozen=True, eq=False)
class TrainedModel(Generic[S]):
    """A trained model of one kind.

    Attributes:
        name: as in its document.
        config: settings of its training.
        params: of its network; of a classifier, with an axis of one seed in front.
        origin: how it was chosen and where it was trained.
    """

    name: str
    config: S
    params: Params
    origin: Mapping[str, Any]


@dataclass(frozen=True)
class WeightFiles(Generic[S]):
    """The files of trained models of one kind.

    Attributes:
        schema: of NAME.json.
        kind: class of the settings.
        what: word for a model, in errors.
        dtype: in which parameters are kept.
    """

    schema: str
    kind: type[S]
    what: str
    dtype: npt.DTypeLike

    def names(self, folder: Path) -> tuple[str, ...]:
        """The names of the trained models in a folder; one without its description was not saved to the end."""
        return tuple(sorted(file.stem for file in folder.glob("*.npz") if file.with_suffix(".json").is_file()))

    def rounded(self, params: Params) -> Params:
        """Parameters as they ship: in the dtype of the files and back."""
        return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf, self.dtype).astype(leaf.dtype), params))

    def save(self, folder: Path, model: TrainedModel[S]) -> None:
        """Write the two files of a model."""
        arrays = named_arrays(model.params)
        content = pack_npz({key: np.asarray(leaf, self.dtype) for key, leaf in arrays.items()})
        described = {
            "schema": self.schema,
            "version": VERSION,
            "settings": model.config.to_json(),
            "sha256": hashlib.sha256(content).hexdigest(),
            "origin": dict(model.origin),
        }
        folder.mkdir(parents=True, exist_ok=True)
        replace_bytes(folder / f"{model.name}.npz", content)
        replace_json(folder / f"{model.name}.json", described)

    def load(self, folder: Path, name: str, start: Callable[[S], Params]) -> TrainedModel[S]:
        """A model.

        Args:
            folder: of the files.
            name: of the model.
            start: gives parameters of some settings, for their shapes.

        Raises:
            ValueError: one line; the name is unknown, or its files are damaged.
        """
        config, content = self._described(folder, name)
        arrays = folder / f"{name}.npz"
        verify_sum(arrays, content.get("sha256"))
        like = jax.eval_shape(lambda: start(config))
        params = restored(read_npz(arrays, MAX_BYTES), like, arrays)
        return TrainedModel(name, config, params, content.get("origin", {}))

    def config(self, folder: Path, name: str) -> S:
        """Settings of a model, whose parameters are not read.

        Raises:
            ValueError: one line; the name is unknown, or the description is damaged.
        """
        return self._described(folder, name)[0]

    def _described(self, folder: Path, name: str) -> tuple[S, Mapping[str, Any]]:
        """Settings and content of NAME.json."""
        described = folder / f"{name}.json"
        if not (described.is_file() and (folder / f"{name}.npz").is_file()):
            known = ", ".join(self.names(folder)) or "none"
            raise ValueError(f"{self.what}: expected one of {known}; got {show(name)}")
        content = read_versioned(described, self.schema, (VERSION,))
        return settings_of(self.kind, content.get("settings"), str(described)), content


def read_state(folder: Path) -> dict[str, npt.NDArray[Any]] | None:
    """The arrays of state.npz; None if there is none.

    Raises:
        ValueError: one line; the file is damaged.
    """
    file = folder / STATE
    return read_npz(file, MAX_BYTES) if file.is_file() else None


def check_losses(folder: Path, losses: npt.ArrayLike, done: str) -> None:
    """Refuse to go on with a model that has diverged; what is saved of its run is that of before.

    Args:
        folder: of the run.
        losses: of the last chunk.
        done: what was made before that chunk, such as "step 400".

    Raises:
        ValueError: one line; a loss is not finite.
    """
    found = np.asarray(losses)
    if not np.isfinite(found).all():
        bad = found[~np.isfinite(found)][0]
        raise ValueError(f"{folder}: training has diverged: after {done} a loss is {bad}")


def parameter_count(params: Any) -> int:  # noqa: ANN401 - a tree of arrays
    """Numbers of one model of several that stand side by side."""
    return sum(leaf[0].size for leaf in jax.tree.leaves(params))
