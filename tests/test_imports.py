"""Imports point one way, and importing the package costs nothing."""

import ast
import importlib
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import requires
from pathlib import Path

import pytest

import iphyre_jax

PACKAGE = Path(iphyre_jax.__file__).parent
ROOT = PACKAGE.parent
PACKAGES = ("iphyre_jax", "parity", "benchmarks")
MOST_FILES = 14  # in one folder, beside its __init__.py

# Every part may import those before it, never one after it. A new part takes its place here.
PARTS = (
    "checks",
    "memory",
    "files",
    "locks",
    "_deprecated",
    "rules",
    "physics",
    "scenes",
    "paper",
    "rollouts",
    "plans",
    "execution",
    "provenance",
    "kept_rows",
    "intervals",
    "simulation",
    "observations",
    "envs",
    "env",
    "adapters",
    "gym",
    "compat",
    "viewer",
    "data",
    "train",
    "attempts",
    "models",
    "analyses",
    "agents",
    "cli",
    "__main__",
)
STRANGERS = {"pymunk", "iphyre", "parity", "benchmarks", "tests"}
ONLY_ABOVE_THE_CORE = {"flax", "optax", "orbax", "matplotlib", "rich", "tyro", "tensorboardX", "scipy"}
ABOVE_THE_CORE = {"train", "models", "cli"}
ADAPTED = {"gymnasium", "brax", "gymnax", "minari", "dm_env", "jumanji", "stable_baselines3"}


def modules() -> list[tuple[str, Path]]:
    """Every file of the package with the part it belongs to; the package's own __init__ belongs to none."""
    files = sorted(PACKAGE.rglob("*.py"))
    return [
        (file.relative_to(PACKAGE).parts[0].removesuffix(".py"), file) for file in files if file.parent != PACKAGE
    ] + [(file.stem, file) for file in files if file.parent == PACKAGE and file.stem != "__init__"]


def imports(file: Path, *, for_types: bool = True) -> Iterator[str]:
    """The full names that a file imports, wherever in it; without those for type checkers alone if asked."""
    package = file.relative_to(ROOT).parent.parts
    nodes = [ast.parse(file.read_text())]
    while nodes:
        node = nodes.pop()
        if for_types or not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            nodes.extend(ast.iter_child_nodes(node))
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            yield from (".".join([*base, *filter(None, [node.module]), alias.name]) for alias in node.names)


@pytest.mark.parametrize(("part", "file"), [pytest.param(p, f, id=str(f.relative_to(PACKAGE))) for p, f in modules()])
def test_imports_point_one_way(part: str, file: Path) -> None:
    assert part in PARTS, f"{part} has no place in PARTS yet"
    allowed = {*PARTS[: PARTS.index(part) + 1], "__version__"}
    for name in imports(file):
        top, *rest = name.split(".")
        assert top not in STRANGERS, f"{file.name} imports {name}"
        assert top not in ONLY_ABOVE_THE_CORE or part in ABOVE_THE_CORE, f"{file.name} imports {name}"
        assert top not in ADAPTED or part == "adapters", f"{file.name} imports {name}"
        if top == "iphyre_jax" and rest:
            assert rest[0] in allowed, f"{file.name} imports {name}, which stands above {part}"


def test_every_part_is_there() -> None:
    assert {part for part, _ in modules()} == set(PARTS)


def module_name(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def test_no_circle_of_imports() -> None:
    files = {module_name(file): file for package in PACKAGES for file in (ROOT / package).rglob("*.py")}
    graph = {
        # Of `from package import name`, the module is either package.name or package.
        module: {name if name in files else name.rpartition(".")[0] for name in imports(file, for_types=False)}
        for module, file in files.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_stay_small(package: str) -> None:
    folders = {file.parent for file in (ROOT / package).rglob("*.py")}
    counts = {str(folder.relative_to(ROOT)): len(list(folder.glob("[!_]*.py"))) for folder in folders}
    assert {folder: count for folder, count in counts.items() if count > MOST_FILES} == {}


IMPORT_COSTS_NOTHING = """
import sys
import jax, numpy
flags = dict(jax.config.values)
before = set(sys.modules)
import iphyre_jax
iphyre_jax.load_scene("support")
iphyre_jax.simulate, iphyre_jax.rollout, iphyre_jax.plan_to_steps, iphyre_jax.configure
from jax._src import xla_bridge
assert not xla_bridge._backends, "a backend was started"
assert flags == dict(jax.config.values), "a flag was changed"
print(*sorted({name.partition(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names))
"""


def run_python(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_needs_jax_and_numpy_only_and_sets_nothing() -> None:
    found = set(run_python("-c", IMPORT_COSTS_NOTHING).split())
    assert "iphyre_jax" in found
    assert found <= {"iphyre_jax", "jax", "jaxlib", "numpy", "ml_dtypes", "opt_einsum"}


def test_import_alone_does_not_even_import_jax() -> None:
    loaded = run_python("-c", "import sys, iphyre_jax; print('jax' in sys.modules, 'numpy' in sys.modules)")
    assert loaded.split() == ["False", "False"]


def test_core_requirements_are_jax_and_numpy() -> None:
    core = [requirement for requirement in requires("iphyre-jax") or [] if "extra ==" not in requirement]
    assert sorted(requirement.partition(">=")[0] for requirement in core) == ["jax", "numpy"]


@pytest.mark.parametrize("name", sorted(set(iphyre_jax.__all__)))
def test_public_names_are_what_they_say(name: str) -> None:
    for module in sorted(set(iphyre_jax._HOME.values())):
        importlib.import_module(f"iphyre_jax.{module}")  # must not put a module in a function's place
    value = getattr(iphyre_jax, name)
    assert name in dir(iphyre_jax)
    if name not in ("GAMES", "SPLITS", "__version__"):
        assert callable(value)
        assert value.__name__ == name


def test_no_module_bears_the_name_of_an_export() -> None:
    assert set(iphyre_jax.__all__).isdisjoint({part for part, _ in modules()})


def names_for_type_checkers() -> dict[str, str]:
    """The names in the TYPE_CHECKING block of the package, each with the module that it is imported from."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    imported = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module).removeprefix("iphyre_jax.") for node in imported for alias in node.names}


def test_every_export_has_a_home_and_a_type() -> None:
    assert set(iphyre_jax.__all__) == {*iphyre_jax._HOME, "__version__"}
    assert names_for_type_checkers() == iphyre_jax._HOME


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"^module 'iphyre_jax' has no attribute 'nothing'$"):
        _ = iphyre_jax.nothing
