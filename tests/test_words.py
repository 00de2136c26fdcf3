"""One word for one thing: names that docs/reference/words.md has retired are given to nothing in this repository."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "words.md"
HEADER = ["word", "meaning", "retired"]
FOLDERS = ("iphyre_jax", "parity", "benchmarks", "tools", "examples")


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def retired_words(page: str) -> dict[str, str]:
    """The words in backticks in the column `retired` of the page's tables, each with the word that took its place."""
    found: dict[str, str] = {}
    inside = False
    for line in page.splitlines():
        row = cells(line) if line.startswith("|") else []
        inside = row == HEADER or (inside and len(row) == len(HEADER))
        if inside:
            found |= dict.fromkeys(re.findall(r"`([^`]+)`", row[2]), row[0].strip("`"))
    return found


def given_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Names that a module gives to functions, classes, arguments, attributes and constants, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno
        if isinstance(node, ast.Module | ast.ClassDef):
            for statement in node.body:
                targets = (
                    statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
                )
                yield from ((target.id, target.lineno) for target in targets if isinstance(target, ast.Name))


def test_tables_of_retired_words_are_read() -> None:
    page = "|word|meaning|retired|\n|---|---|---|\n| `obs` | seen | `seen`, `sight` |\n\n| a | b |\n| `c` | `d` |\n"
    assert retired_words(page) == {"seen": "obs", "sight": "obs"}


def test_names_of_all_sorts_are_found() -> None:
    code = "A = 1\nb: int = 2\nclass C:\n    d: int\n    def e(self, f): self.g = h = i.j\n"
    assert {name for name, _ in given_names(ast.parse(code))} == {"A", "b", "C", "d", "e", "self", "f", "g"}


def test_no_retired_word_is_used() -> None:
    words = retired_words(PAGE.read_text(encoding="utf-8"))
    assert words
    used = []
    for file in sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        place = file.relative_to(ROOT).as_posix()
        names = [(file.stem, 0), *given_names(ast.parse(file.read_text(encoding="utf-8")))]
        used += [f"{place}:{line}: {name} is now {words[name]}" for name, line in names if name in words]
    assert not used, "\n" + "\n".join(used)
