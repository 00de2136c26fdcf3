"""How the commands of this folder end: one line for what a caller can mend."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar

import tyro

Arguments = TypeVar("Arguments")


def run(main: Callable[[Arguments], None], kind: type[Arguments]) -> int:
    """Parse the command line and run a command; return 0, 2 for an error of one line, 130 if it was interrupted."""
    try:
        main(tyro.cli(kind))
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0
