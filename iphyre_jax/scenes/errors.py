"""Error messages of one line each: how to show a wrong value, and how to raise all problems at once."""

from collections.abc import Mapping, Sequence
from typing import Final

MAX_LINES: Final = 20  # wrong fields that one error lists
_MAX_SHOWN: Final = 60  # characters of a value in a message


def show(value: object) -> str:
    """Write any value, however large, as one short printable line."""
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if isinstance(value, Mapping):
        return f"an object of {len(value)} fields"
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {value.bit_length()} bits"  # Python refuses to print very long ones
    text = one_line(repr(value[: 2 * _MAX_SHOWN] if isinstance(value, str) else value))
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."


def one_line(text: str) -> str:
    """Escape line breaks and other unprintable characters."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def raise_problems(source: str, problems: Sequence[str]) -> None:
    """Raise an error if there are problems.

    Args:
        source: the wrong file or argument.
        problems: "field: expected ..., got ..." for each wrong field.

    Raises:
        ValueError: one line for each of the first 20 problems, which begins with the source, and a count of the others.
    """
    if not problems:
        return
    lines = list(problems[:MAX_LINES])
    if len(problems) > MAX_LINES:
        lines.append(f"and {len(problems) - MAX_LINES} more wrong fields")
    raise ValueError("\n".join(f"{one_line(source)}: {line}" for line in lines))
