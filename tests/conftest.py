"""What holds for every test: the CPU, arrays of different rank never meet unsaid, no test fails for being slow."""

import os
import signal
from pathlib import Path

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

jax.config.update("jax_numpy_rank_promotion", "raise")
# jax_numpy_dtype_promotion stays "standard": masks (bool) and counts (int32) multiply floats in rewards and losses.
# What JAX compiles in one test process, the other one loads. Not by the environment: processes that tests start are a
# user's, without it.
jax.config.update("jax_compilation_cache_dir", os.environ["IPHYRE_JAX_CACHE"] + "-jax")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# Speed is measured in benchmarks/; on a machine that has other work a time limit says nothing about the code.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes long, so that no worker is left with it at the end."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
