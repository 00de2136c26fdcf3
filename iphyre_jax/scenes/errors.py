"""How the problems of a scene become one error."""

from collections.abc import Sequence
from typing import Final

from iphyre_jax.checks import one_line

MAX_LINES: Final = 20  # wrong fields that one error tells in full


def refuse(source: str, problems: Sequence[str]) -> None:
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
