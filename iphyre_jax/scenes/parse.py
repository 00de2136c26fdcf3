"""Parse each field of a scene by itself: types, lengths of rows, ranges of numbers.

The result is a RawScene of plain Python numbers. `validate` checks how the fields fit together.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from iphyre_jax.checks import one_line, show
from iphyre_jax.scenes.limits import MAX_COORDINATE, MAX_NAME, OFFICIAL, Limits

Point = tuple[float, float]
Bar = tuple[Point, Point]
Ball = tuple[float, float, float]
Pair = tuple[int, int]
Row = TypeVar("Row")

REQUIRED: Final = ("block", "ball", "eli", "dynamic")
OPTIONAL: Final = ("joint", "spring")

_MANY: Final = 10_000  # numbers in one array; more are refused before Python's own are made of them
_LEVELS: Final = 4  # of nesting in the deepest field: bars, bar, end point, number


@dataclass(frozen=True)
class RawScene:
    """A scene whose fields have the right types. Objects are the bars in order, then the balls."""

    name: str
    blocks: list[Bar]  # end points, px
    balls: list[Ball]  # x, y, radius, px
    eliminable: list[bool]  # one for each object
    dynamic: list[bool]  # one for each object
    joints: list[Pair]  # object indices
    springs: list[Pair]  # object indices
    limits: Limits

    def centre(self, index: int) -> Point:
        """Return the centre of an object, px."""
        if index >= len(self.blocks):
            x, y, _ = self.balls[index - len(self.blocks)]
            return x, y
        (x1, y1), (x2, y2) = self.blocks[index]
        return (x1 + x2) / 2, (y1 + y2) / 2


def parse_scene(
    fields: Mapping[str, object], labels: Mapping[str, str], limits: Limits | None
) -> tuple[RawScene, list[str]]:
    """Parse every field of a scene.

    Args:
        fields: numbers, text, lists and NumPy arrays by name; OPTIONAL ones may be missing.
        labels: the name of each field in error messages.
        limits: of the scene; they replace its field "limits".

    Returns:
        The scene, and "field: expected ..., got ..." for each wrong field. If there are wrong fields, do not use the
        scene: it holds placeholders in their place.
    """
    parser = _FieldParser()
    for key in REQUIRED:
        if key not in fields:
            parser.problems.append(f"{labels[key]}: expected this field, but it is missing")

    limits = parser.limits(fields.get("limits")) if limits is None else limits
    objects, pairs = limits.objects, limits.objects * (limits.objects - 1) // 2

    def rows(key: str, form: str, read: Callable[[str, object], Row], most: int) -> list[Row]:
        return parser.rows(labels[key], fields.get(key, []), form, read, most)

    raw = RawScene(
        name=parser.name(fields.get("name")),
        blocks=rows("block", "bars [[x1, y1], [x2, y2]]", parser.bar, objects),
        balls=rows("ball", "balls [x, y, radius]", parser.ball, objects),
        eliminable=rows("eli", "flags 0 or 1", parser.flag, 2 * objects),
        dynamic=rows("dynamic", "flags 0 or 1", parser.flag, 2 * objects),
        joints=rows("joint", "pairs [object, object]", parser.pair, pairs),
        springs=rows("spring", "pairs [object, object]", parser.pair, pairs),
        limits=limits,
    )
    return raw, parser.problems


def _plain(value: object, levels: int = _LEVELS) -> object:
    """Turn NumPy arrays and scalars, also inside lists, into plain Python; deeper levels are wrong anyway."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)) and levels > 1:
        return [_plain(entry, levels - 1) for entry in value]
    return value


class _FieldParser:
    """Parse one value at a time. A wrong value is reported in `problems` and replaced by a placeholder."""

    def __init__(self) -> None:
        self.problems: list[str] = []

    def report(self, label: str, expected: str, value: object) -> None:
        self.problems.append(f"{label}: expected {expected}, got {show(value)}")

    def name(self, value: object) -> str:
        if isinstance(value, str) and 0 < len(value) <= MAX_NAME and value.isprintable() and value == value.strip():
            return value
        self.report("name", f"a text of 1 to {MAX_NAME} printable characters without blanks at its ends", value)
        return ""

    def limits(self, value: object) -> Limits:
        """Parse the limits; without any, the official limits apply."""
        if value is None:
            return OFFICIAL
        if not isinstance(value, Mapping) or not set(value) <= {"objects", "blocks"}:
            self.report("limits", 'an object {"objects": ..., "blocks": ...}', value)
            return OFFICIAL
        try:
            return Limits(**value)
        except ValueError as error:
            self.problems.append(one_line(str(error)))
            return OFFICIAL

    def rows(self, label: str, given: object, form: str, read: Callable[[str, object], Row], most: int) -> list[Row]:
        large = given.size > _MANY if isinstance(given, np.ndarray) else False
        if large or (isinstance(given, (list, tuple)) and len(given) > most):  # before a copy is made
            self.report(label, f"at most {most} entries", given)
            return []
        value = _plain(given)
        if not isinstance(value, (list, tuple)):
            self.report(label, f"a list of {form}", value)
            return []
        if len(value) > most:
            self.report(label, f"at most {most} entries", value)
            return []
        if read != self.flag and value and not any(isinstance(entry, (list, tuple)) for entry in value):
            self.report(label, f"a list of {form}", value)  # most likely one row without its outer list
            return []
        return [read(f"{label}[{i}]", entry) for i, entry in enumerate(value)]

    def bar(self, label: str, value: object) -> Bar:
        ends = self.entries(label, value, 2, "a bar [[x1, y1], [x2, y2]]")
        start, end = (self.point(f"{label}[{i}]", point) for i, point in enumerate(ends)) if ends else _NO_BAR
        return start, end

    def point(self, label: str, value: object) -> Point:
        x, y = self.entries(label, value, 2, "an end point [x, y]") or (0, 0)
        return self.number(f"{label}[0]", x), self.number(f"{label}[1]", y)

    def ball(self, label: str, value: object) -> Ball:
        x, y, radius = self.entries(label, value, 3, "a ball [x, y, radius]") or (0, 0, 0)
        return self.number(f"{label}[0]", x), self.number(f"{label}[1]", y), self.number(f"{label}[2]", radius)

    def pair(self, label: str, value: object) -> Pair:
        a, b = self.entries(label, value, 2, "a pair of object indices [a, b]") or (0, 0)
        return self.index(f"{label}[0]", a), self.index(f"{label}[1]", b)

    def entries(self, label: str, value: object, count: int, expected: str) -> list[object]:
        """Parse a list of `count` entries; return an empty list if it is wrong."""
        if isinstance(value, (list, tuple)) and len(value) == count:
            return list(value)
        self.report(label, expected, value)
        return []

    def number(self, label: str, value: object) -> float:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= MAX_COORDINATE:
            return float(value)
        self.report(label, f"a finite number of px from {-MAX_COORDINATE:g} to {MAX_COORDINATE:g}", value)
        return 0.0

    def index(self, label: str, value: object) -> int:
        if isinstance(value, int) and not isinstance(value, bool):
            return value
        self.report(label, "an object index (an integer)", value)
        return 0

    def flag(self, label: str, value: object) -> bool:
        if isinstance(value, int) and not isinstance(value, bool) and value in (0, 1):
            return value == 1
        self.report(label, "0 or 1", value)
        return False


_NO_BAR: Final[Bar] = ((0.0, 0.0), (0.0, 0.0))
