"""Logs of a run: metrics.csv always, TensorBoard files on request. Each update's line is written at once."""

from __future__ import annotations

import csv
import importlib
import io
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

from iphyre_jax.checks import show
from iphyre_jax.files import naming, replacing
from iphyre_jax.train.trainer import Metrics

FILE: Final = "metrics.csv"
TENSORBOARD: Final = "tensorboard"
WHOLE: Final = re.compile("[0-9]{1,10}")  # an update
MAX_LINE: Final = 10_000  # bytes of a line of metrics.csv


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


def read(run: Path, numbers: Sequence[str] = (), optional: Sequence[str] = ()) -> list[dict[str, str]]:
    """The complete lines of a run's metrics.csv; a line that a kill has cut short is left out.

    Args:
        run: its folder.
        numbers: columns that must be there and hold numbers in every line.
        optional: columns that must be there; a cell of theirs may be empty.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no such file; one line that names the line and the column.
    """
    return list(_lines(run / FILE, numbers, optional))


def _lines(file: Path, numbers: Sequence[str], optional: Sequence[str]) -> Iterator[dict[str, str]]:
    """See `read`; one line at a time, for a long run's file is large."""
    with file.open("rb") as opened:
        header = _row(opened, file, 1) or []
        missing = [name for name in ("update", *numbers, *optional) if header.count(name) != 1]
        if header and missing:
            raise ValueError(f"{file}: expected a column {missing[0]} once, got columns {show(','.join(header))}")
        count = 1
        while (cells := _row(opened, file, count + 1)) is not None:
            count += 1
            if len(cells) != len(header):
                raise ValueError(f"{file}: line {count}: expected {len(header)} cells, got {len(cells)}")
            line = dict(zip(header, cells, strict=True))
            if not WHOLE.fullmatch(line["update"]):
                raise ValueError(f"{file}: line {count}, update: expected a whole number, got {show(line['update'])}")
            for name in (*numbers, *(name for name in optional if line[name])):
                _check_number(line[name], f"{file}: line {count}, {name}")
            yield line


def _row(opened: BinaryIO, file: Path, count: int) -> list[str] | None:
    """The cells of the next complete line; None at the end."""
    raw = opened.readline(MAX_LINE + 1)
    if len(raw) > MAX_LINE:
        raise ValueError(f"{file}: line {count}: expected at most {MAX_LINE} bytes, got more")
    if not raw.endswith(b"\n"):
        return None
    try:
        return next(csv.reader([raw.decode("utf-8")], strict=True), [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file}: line {count}: expected CSV: {error}") from None


def _check_number(cell: str, where: str) -> None:
    """Refuse a cell that holds no number; NaN is one, for a loss may be NaN."""
    try:
        float(cell)
    except ValueError:
        raise ValueError(f"{where}: expected a number, got {show(cell)}") from None


class Log:
    """The open logs of a run."""

    def __init__(self, run: Path, columns: Sequence[str], update: int, *, tensorboard: bool) -> None:
        """Begin the logs, or continue after so many updates; later lines are removed, they will be written again.

        Attributes:
            missing: how many of the updates made so far have no line; a disk that lost power may have lost some.

        Raises:
            ValueError: metrics.csv is there and holds something else; one line. It stays as it is.
        """
        self._file = run / FILE
        self._columns = tuple(columns)
        self.missing = update
        with replacing(self._file) as draft, draft.open("w", encoding="utf-8") as file:
            file.write(_text(self._columns))
            lines = _lines(self._file, (), self._columns) if self._file.exists() else ()
            for line in lines:
                if int(line["update"]) <= update:
                    file.write(_text([line[name] for name in self._columns]))
                    self.missing -= 1
        self._summary_writer: Any = _summary_writer(run / TENSORBOARD, update) if tensorboard else None

    def add(self, metrics: Metrics) -> None:
        """Append the metrics of an update.

        Raises:
            OSError: the line cannot be written; one line. What stands there of it is cut when the run goes on.
        """
        with naming(self._file), self._file.open("a", encoding="utf-8") as file:
            file.write(_text([_cell(metrics[name]) for name in self._columns]))
        if self._summary_writer is not None:
            for name, value in metrics.items():
                if value is not None:
                    self._summary_writer.add_scalar(name, value, metrics["update"])
            self._summary_writer.flush()

    def sync(self) -> None:
        """Wait until all lines are on the disk, so that no checkpoint is there without them.

        Raises:
            OSError: they cannot be written; one line.
        """
        with naming(self._file), self._file.open("rb") as file:
            os.fsync(file.fileno())

    def close(self) -> None:
        """Close what is open."""
        if self._summary_writer is not None:
            self._summary_writer.close()


def import_tensorboard() -> Any:  # noqa: ANN401 - tensorboardX has no types
    """The package that writes TensorBoard files; ValueError in one line if the extra is missing."""
    try:
        return importlib.import_module("tensorboardX")
    except ModuleNotFoundError:
        raise ValueError(
            "tensorboard: expected the extra 'tensorboard': pip install 'iphyre-jax[tensorboard]'"
        ) from None


def _summary_writer(folder: Path, update: int) -> Any:  # noqa: ANN401 - tensorboardX has no types
    """A writer of TensorBoard files that replaces what came after so many updates.

    Raises:
        ValueError: one line; the extra is missing.
    """
    return import_tensorboard().SummaryWriter(str(folder), purge_step=update + 1)
