"""Values that an argument of some kind must refuse, and rows of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from iphyre_jax.checks import show

LONGEST = 400  # characters of a message
NAN, INF, HUGE = float("nan"), float("inf"), 10**400
WHOLE = (None, "3", 2.5, NAN, True, [1], -7, HUGE)
NUMBER = (None, "3", NAN, INF, -INF, True, [1.0], 2j, HUGE)
FLAG = (None, 1, "yes", [True])
WORD = (None, 3, "nonsense", ["official"], "x" * 10**6)
SCENE = (None, 3, "", "no such game", b"hole", ["hole"], "a\0.json")
ARRAY = (None, "x", 1, [[1], [1, 2]], [[0.5, 1.5]], [[None]], [[HUGE]], {"a": 1}, np.zeros((1, 2, 3), int))
THING = (None, 3, "x", [1], object())


@dataclass(frozen=True)
class Case:
    """One bad argument.

    Attributes:
        call: the function.
        argument: what is bad; the message names it.
        value: that is to be refused.
        run: calls the function with the value.
    """

    call: str
    argument: str
    value: Any
    run: Callable[[Any], object]

    def __str__(self) -> str:
        """Name the case."""
        return f"{self.call}({self.argument}={show(self.value)})"


def complaint(case: Case) -> str:
    """Return what is wrong with how a bad argument is refused, empty if nothing is."""
    try:
        case.run(case.value)
    except (ValueError, TypeError) as error:
        said = str(error)
        if "\n" in said or len(said) > LONGEST:
            return f"{case}: expected one line, got {said[:200]!r}"
        return "" if case.argument in said else f"{case}: expected the argument's name, got {said!r}"
    except Exception as error:
        return f"{case}: expected a ValueError or a TypeError, got {type(error).__name__}: {error}"
    return f"{case}: expected a refusal"


Row = tuple[str, str, Sequence[Any], Callable[[Any], object]]


def keywords(call: str, function: Callable[..., object], bad: dict[str, Sequence[Any]]) -> list[Row]:
    """Return a row for each keyword of a function."""
    return [(call, name, values, lambda v, name=name: function(**{name: v})) for name, values in bad.items()]
