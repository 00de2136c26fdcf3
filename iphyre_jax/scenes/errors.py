"""One-line messages: how a wrong value is shown and how findings become an error."""

from collections.abc import Mapping, Sequence
from typing import Final

MAX_LINES: Final = 20  # wrong fields that one error tells in full
_MAX_SHOWN: Final = 60  # characters of a value that is shown


def show(value: object) -> str:
    """Write any value, however large or strange, in one short printable line."""
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if isinstance(value, Mapping):
        return f"an object of {len(value)} fields"
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {value.bit_length()} bits"  # Python refuses to print the largest ones
    text = one_line(repr(value[: 2 * _MAX_SHOWN] if isinstance(value, str) else value))
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."


def one_line(text: str) -> str:
    """Escape line breaks and all other characters that do not print."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def raise_problems(source: str, problems: Sequence[str]) -> None:
    """Raise what was found, if anything.

    Args:
        source: the file or argument that is at fault.
        problems: "field: expected ..., got ..." for each wrong field.

    Raises:
        ValueError: there are problems; one line for each (after 20, their number), each beginning with the source.
    """
    if not problems:
        return
    lines = list(problems[:MAX_LINES])
    if len(problems) > MAX_LINES:
        lines.append(f"and {len(problems) - MAX_LINES} more wrong fields")
    raise ValueError("\n".join(f"{one_line(source)}: {line}" for line in lines))
