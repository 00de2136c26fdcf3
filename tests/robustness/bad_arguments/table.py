"""Every bad argument."""

from __future__ import annotations

from tests.robustness.bad_arguments import commands, environments, interfaces, scenes, simulation, viewer
from tests.robustness.bad_arguments.kinds import Case


def cases() -> list[Case]:
    """Return every bad argument of every public call."""
    groups = (simulation, scenes, environments, interfaces, viewer, commands)
    rows = [row for group in groups for row in group.rows()]
    return [Case(call, name, value, run) for call, name, values, run in rows for value in values]
