"""The documents say what is so: their examples run and print what they show, their links and commands exist."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path
from typing import NamedTuple

import jax
import pytest

from iphyre_jax.cli import app
from tools.readme_figures import with_figures

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
GUIDES = sorted((ROOT / "docs" / "guide").rglob("*.md"))
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
README_BYTES = 8000

FENCED = re.compile(r"^```(\w*)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


class Example(NamedTuple):
    code: str
    line: int
    shown: str | None  # what stands right below it, indented


def examples(page: Path) -> list[Example]:
    text = page.read_text("utf-8")
    found = []
    for block in FENCED.finditer(text):
        if block[1] == "python":
            below = re.match(r"\n((?: {4}.*\n|\n(?= {4}))+)", text[block.end() :])
            shown = re.sub(r"^ {4}", "", below[1], flags=re.MULTILINE) if below else None
            found.append(Example(block[2], text.count("\n", 0, block.start()) + 2, shown))
    return found


def commands(page: Path) -> list[str]:
    lines = [line.strip() for line in page.read_text("utf-8").splitlines() if line.startswith("    ")]
    return [line for line in lines if line.startswith("iphyre-jax ")]


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in (README, *GUIDES) if examples(page)], ids=name)
def test_the_examples_of_a_page_run_and_print_what_it_shows(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "example"}
    for example in examples(page):
        code = compile("\n" * (example.line - 1) + example.code, page, "exec")
        with contextlib.redirect_stdout(io.StringIO()) as printed, jax.numpy_rank_promotion("allow"):
            exec(code, namespace)  # noqa: S102 - our own documents
        if example.shown is not None:
            assert printed.getvalue() == example.shown, f"{name(page)}:{example.line}"


def test_the_figures_of_the_readme_are_those_of_the_results() -> None:
    readme = README.read_text("utf-8")
    assert with_figures(readme, ROOT / "docs" / "results") == readme, "run tools/readme_figures.py"


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=name)
def test_the_commands_of_a_page_parse(page: Path) -> None:
    for command in commands(page):
        try:
            app._parse(shlex.split(command, comments=True)[1:])
        except SystemExit:
            pytest.fail(f"{name(page)}: {command}")


def test_the_index_of_decisions_has_their_titles() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = re.findall(r"^\* \[(.+)\]\((\w+\.md)#", (folder / "index.md").read_text("utf-8"), re.MULTILINE)
    pages = sorted(page.name for page in folder.glob("*.md") if page.name != "index.md")
    titles = [
        (title, page) for page in pages for title in re.findall(r"^### (.+)$", (folder / page).read_text("utf-8"), re.M)
    ]
    assert sorted(listed) == sorted(titles)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_the_links_and_pictures_of_a_page_exist(page: Path) -> None:
    for target in LINK.findall(FENCED.sub("", page.read_text("utf-8"))):
        file, _, _ = target.partition("#")  # `make docs` checks the anchors
        assert target.startswith("https://") or not file or (page.parent / file).is_file(), target


def test_the_readme_is_short() -> None:
    assert README.stat().st_size <= README_BYTES
