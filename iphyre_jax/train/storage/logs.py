"""Logs of a run: metrics.csv always, TensorBoard files on request. Each update's line is written at once."""

from __future__ import annotations

import csv
import importlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from iphyre_jax.files import replace_text
from iphyre_jax.train.trainer import Metrics

FILE: Final = "metrics.csv"
TENSORBOARD: Final = "tensorboard"


def _text(values: Sequence[object]) -> str:
    """A line of CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(values)
    return buffer.getvalue()


def _cell(value: float | None) -> str:
    """A number in a cell; nothing for None, which was not measured."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def read(run: Path) -> list[dict[str, str]]:
    """The complete lines of a run's metrics.csv; a line that a kill has cut short is left out.

    Raises:
        FileNotFoundError: there is none.
    """
    text = (run / FILE).read_text("utf-8")
    whole = text[: text.rfind("\n") + 1]
    return list(csv.DictReader(io.StringIO(whole)))


class Log:
    """The open logs of a run."""

    def __init__(self, run: Path, columns: Sequence[str], update: int, *, tensorboard: bool) -> None:
        """Begin the logs, or continue after so many updates; later lines are removed, they will be written again."""
        self._file = run / FILE
        self._columns = tuple(columns)
        kept = [line for line in read(run) if int(line["update"]) <= update] if self._file.exists() else []
        text = _text(self._columns) + "".join(_text([line[name] for name in self._columns]) for line in kept)
        replace_text(self._file, text)
        self._summary_writer: Any = _summary_writer(run / TENSORBOARD, update) if tensorboard else None

    def add(self, metrics: Metrics) -> None:
        """Append the metrics of an update."""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(_text([_cell(metrics[name]) for name in self._columns]))
        if self._summary_writer is not None:
            for name, value in metrics.items():
                if value is not None:
                    self._summary_writer.add_scalar(name, value, metrics["update"])
            self._summary_writer.flush()

    def close(self) -> None:
        """Close what is open."""
        if self._summary_writer is not None:
            self._summary_writer.close()


def _summary_writer(folder: Path, update: int) -> Any:  # noqa: ANN401 - tensorboardX has no types
    """A writer of TensorBoard files that replaces what came after so many updates.

    Raises:
        ValueError: one line; the extra is missing.
    """
    try:
        tensorboard = importlib.import_module("tensorboardX")
    except ModuleNotFoundError:
        raise ValueError(
            "tensorboard: expected the extra 'tensorboard': pip install 'iphyre-jax[tensorboard]'"
        ) from None
    return tensorboard.SummaryWriter(str(folder), purge_step=update + 1)
