"""The skeleton: what a fresh clone needs to be whole."""

import os
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXTRAS = {"train", "parity", "tensorboard", "viewer", "dev", "docs", "all", "browser"}
EXTRAS |= {"brax", "dm-env", "gymnasium", "gymnax", "jumanji", "llm", "minari", "sb3"}
TARGETS = ("help", "venv", "run", "test", "test-fast", "lint", "parity", "wheel", "bench")


def project() -> dict[str, object]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def name_of(requirement: str) -> str:
    return re.split(r"[\[=<>]", requirement)[0].lower().replace("_", "-")


def test_constraints_are_names_and_versions_only() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.+]+", line) for line in lines)


def test_every_requirement_of_the_venv_has_its_constraint() -> None:
    pinned = {name_of(line) for line in (ROOT / "constraints.txt").read_text().splitlines()}
    extras = project()["optional-dependencies"]
    wanted = [*project()["dependencies"], *extras["train"], *extras["parity"], *extras["dev"]]
    assert {name_of(requirement) for requirement in wanted} - {"iphyre-jax"} <= pinned


def test_requirements_have_lower_bounds_only() -> None:
    extras = project()["optional-dependencies"]
    assert set(extras) == EXTRAS
    for requirement in [*project()["dependencies"], *(entry for extra in extras.values() for entry in extra)]:
        assert re.fullmatch(r"iphyre-jax\[[a-z,]+\]|[A-Za-z0-9-]+(\[[a-z0-9]+\])?>=[0-9.]+", requirement), requirement


@pytest.mark.parametrize("target", TARGETS)
def test_makefile_has_its_targets(target: str) -> None:
    assert re.search(rf"^{target}:.*## ", (ROOT / "Makefile").read_text(), re.MULTILINE)


def test_ci_runs_make_test() -> None:
    assert (ROOT / ".ci" / "run").read_text().rstrip().endswith("make test")
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_notices_are_given() -> None:
    licence, notice = (ROOT / "LICENSE").read_text(), (ROOT / "NOTICE").read_text()
    assert "the iphyre_jax developers" in licence
    assert "Copyright (c) 2022 CoRe" in notice
    assert "iphyre 0.2.3" in notice
    permission = licence[licence.index("Permission is hereby granted") :]
    assert notice.endswith(permission)
