"""What the package keeps in memory is bounded, whatever it has played."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

import iphyre_jax
from iphyre_jax.execution.compilation import executables
from iphyre_jax.execution.programs import Score
from iphyre_jax.scenes.compile import topology_of

PACKAGE = Path(iphyre_jax.__file__).parent
# Caches without a bound: what each call's arguments can be is bounded.
BOUNDED_BY_NATURE = {
    "_read_library": "no arguments",
    "_test_games": "no arguments",
    "plan_stream": "numbers of eliminable blocks, up to six",
    "_package_game": "the games of the package",
    "_client": "no arguments",
    "_libc": "no arguments",
    "check_linking": "no arguments",
    "_devices": "no arguments",
    "_sharding": "no arguments",
    "machine": "no arguments",
    "_helpers": "numbers of threads that `configure` was given",
    "source_sum": "the kinds of programs",
    "void": "widths of a row",
    "font": "sizes of a font",
    "best_plays": "no arguments",
    "paper_numbers": "no arguments",
    "policies": "no arguments",
    "shipped": "the two rates of the package's data",
    "shared_simulator": "no arguments",
}


def unbounded() -> set[str]:
    """The functions of the package under `functools.cache` or an lru_cache without a bound."""
    found = set()
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef):
                for decorator in map(ast.unparse, node.decorator_list):
                    if (
                        decorator in ("cache", "functools.cache", "lru_cache")
                        or "None" in decorator.partition("lru_cache")[2]
                    ):
                        found.add(node.name)
    return found


def test_every_cache_has_a_bound_or_a_reason() -> None:
    assert unbounded() <= set(BOUNDED_BY_NATURE), unbounded() - set(BOUNDED_BY_NATURE)


def test_the_least_recently_prepared_program_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: dict[Any, Any] = {}
    monkeypatch.setattr(executables, "_loaded", loaded)
    monkeypatch.setattr(executables, "LOADED", 4)
    topology = topology_of(iphyre_jax.load_scene("hole"))
    programs = [Score(topology, "float32", lanes, 6) for lanes in range(1, 7)]
    for program in programs[:4]:
        executables._keep(program, lambda: ())
    executables.prepare([programs[0]])
    for program in programs[4:]:
        executables._keep(program, lambda: ())
    assert list(loaded) == [programs[3], programs[0], *programs[4:]]
