"""Logs of a run: metrics.csv always, TensorBoard files if wanted; a line is there before the next round begins."""

from __future__ import annotations

import csv
import importlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from iphyre_jax.files import replace_text
from iphyre_jax.train.trainer import Line

FILE: Final = "metrics.csv"
TENSORBOARD: Final = "tensorboard"


def _text(values: Sequence[object]) -> str:
    """A line of CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(values)
    return buffer.getvalue()


def _cell(value: float | None) -> str:
    """A number in a cell; nothing for one that was not measured."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def read(run: Path) -> list[dict[str, str]]:
    """The whole lines of a run's metrics.csv; one that a kill has cut off is left out.

    Raises:
        FileNotFoundError: there is none.
    """
    text = (run / FILE).read_text("utf-8")
    whole = text[: text.rfind("\n") + 1]
    return list(csv.DictReader(io.StringIO(whole)))


class Log:
    """The open logs of a run."""

    def __init__(self, run: Path, columns: Sequence[str], update: int, *, tensorboard: bool) -> None:
        """Begin the logs, or go on after so many rounds: later lines are cut off, for they will be written again."""
        self._file = run / FILE
        self._columns = tuple(columns)
        kept = [line for line in read(run) if int(line["update"]) <= update] if self._file.exists() else []
        text = _text(self._columns) + "".join(_text([line[name] for name in self._columns]) for line in kept)
        replace_text(self._file, text)
        self._board: Any = _board(run / TENSORBOARD, update) if tensorboard else None

    def add(self, line: Line) -> None:
        """Append a line."""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(_text([_cell(line[name]) for name in self._columns]))
        if self._board is not None:
            for name, value in line.items():
                if value is not None:
                    self._board.add_scalar(name, value, line["update"])
            self._board.flush()

    def close(self) -> None:
        """Close what is open."""
        if self._board is not None:
            self._board.close()


def _board(folder: Path, update: int) -> Any:  # noqa: ANN401 - tensorboardX has no types
    """A writer of TensorBoard files that takes the place of what came after so many rounds.

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
