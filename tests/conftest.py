"""What holds for every test: the CPU, arrays of different rank never meet unsaid, no test fails for being slow."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

if not os.environ.get("IPHYRE_JAX_CHECK_GPU"):  # for `make test-gpu` alone
    os.environ["JAX_PLATFORMS"] = "cpu"  # before jax is imported anywhere
os.environ["IPHYRE_JAX_CONFIGURE"] = "off"  # commands run in here would set what holds for the whole process
# Programs of all test processes, kept from run to run: not the user's, and gone with `make clean`.
os.environ.setdefault("IPHYRE_JAX_CACHE", str(Path(__file__).parents[1] / "build" / "test-cache"))

# A shell that starts tests in the background lets them ignore Ctrl-C; tests that interrupt need it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import jax
import pytest
from hypothesis import HealthCheck, settings
from jax._src import compiler

from iphyre_jax.execution.compilation import executables
from iphyre_jax.execution.compilation.executables import Run
from iphyre_jax.execution.programs import Program
from iphyre_jax.memory import forget_programs
from iphyre_jax.viewer.play.worker import memory_in_use

TESTS = Path(__file__).parent

jax.config.update("jax_numpy_rank_promotion", "raise")
# jax_numpy_dtype_promotion stays "standard": masks (bool) and counts (int32) multiply floats in rewards and losses.
# What JAX compiles in one test process, the other one loads. Not by the environment: processes that tests start are a
# user's, without it.
jax.config.update("jax_compilation_cache_dir", os.environ["IPHYRE_JAX_CACHE"] + "-jax")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# Tracing makes millions of small objects that no cycle holds; Python would look through all of them again and again.
gc.set_threshold(100_000, 50, 100)

# Speed is measured in benchmarks/; on a machine that has other work a time limit says nothing about the code.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes long, and there with what compiles most, so that no worker is left with it at the end.

    Modules stay together: their fixtures are made once, and what one test compiled the next one has.
    """
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: int(not _is_as_for_users(item.path)) if item.path in long else 2)
    if not os.environ.get("IPHYRE_JAX_CHECK_ALL"):
        for item in items:
            if item.get_closest_marker("further"):
                item.add_marker(pytest.mark.skip(reason="takes long: make test-further"))


# Here the engine's programs are compiled as they are for users. All other tests ask what the code means, not what a
# compiler makes of it; they work on a few numbers, and most of their time would be spent on optimising.
AS_FOR_USERS = (
    "benchmarks",
    "execution",
    "gpu",
    "parity/fuzz",
    "parity/test_golden.py",
    "parity/test_main.py",
    "parity/test_planted.py",
    "parity/test_sample.py",
    "physics/collision",
    "physics/test_batching.py",
    "physics/test_compiled_steps.py",
    "test_determinism.py",
    "test_simulation.py",
)


def _is_as_for_users(path: Path) -> bool:
    return path.relative_to(TESTS).as_posix().startswith(AS_FOR_USERS)


# LLVM's lowest level, and XLA's older loops: the newer ones alone take longer than all else of a quick compilation. And
# one module of a program, not one for each thread: a network takes a quarter less.
QUICK = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": 1,
}
_quick_programs: dict[Program, Run] = {}


@contextmanager
def quick_jax() -> Iterator[None]:
    """Let JAX compile with few optimisations in this process."""
    usual = compiler.get_compile_options

    def quick(*given: Any, env_options_overrides: dict[str, Any] | None = None, **named: Any) -> Any:
        return usual(*given, env_options_overrides={**QUICK, **(env_options_overrides or {})}, **named)

    jax.config.update("jax_disable_most_optimizations", True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "get_compile_options", quick)
        yield
    jax.config.update("jax_disable_most_optimizations", False)


@contextmanager
def quick_engine() -> Iterator[None]:
    """Let processes of the engine compile with few optimisations; the two kinds of programs are never mixed up."""
    usual = executables.options_for
    with pytest.MonkeyPatch.context() as patch:
        options = {f"--{name}": str(value).lower() for name, value in QUICK.items()}
        patch.setattr(executables, "options_for", lambda lanes: {**usual(lanes), **options})
        patch.setattr(executables, "_loaded", _quick_programs)
        yield


@pytest.fixture(scope="module", autouse=True)
def quick_compilation(request: pytest.FixtureRequest) -> Iterator[None]:
    """Compile quickly what a module tries, unless it is of AS_FOR_USERS."""
    if _is_as_for_users(request.path):
        yield
        return
    with quick_jax(), quick_engine():
        yield


# A test process that is larger, in bytes, forgets its programs after a module. They are on the disk, and two such
# processes fit into a small machine.
MOST_MEMORY = 2e9


@pytest.fixture(scope="module", autouse=True)
def little_memory() -> Iterator[None]:
    """Let a process that has grown forget its programs."""
    yield
    if memory_in_use() > MOST_MEMORY:
        executables._loaded.clear()
        _quick_programs.clear()
        forget_programs()


@pytest.fixture
def quickly() -> Callable[[], AbstractContextManager[None]]:
    """For a part of a module of AS_FOR_USERS: `quick_engine`."""
    return quick_engine


@pytest.fixture(scope="module")
def quick_programs() -> Iterator[None]:
    """For a module of AS_FOR_USERS: how programs of the engine are optimised is no claim of the module."""
    with quick_engine():
        yield


@pytest.fixture(scope="module")
def few_optimisations() -> Iterator[None]:
    """For a module of AS_FOR_USERS: what this process itself compiles is no claim of the module."""
    with quick_jax():
        yield
