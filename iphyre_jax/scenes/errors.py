"""How the problems of a scene become one error."""

from collections.abc import Sequence
from typing import Final

from iphyre_jax.checks import one_line

MAX_LINES: Final = 20  # wrong fields that one error lists


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
