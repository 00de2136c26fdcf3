"""What holds for every test: the CPU, arrays of different rank never meet unsaid, no test fails for being slow."""

import os
from pathlib import Path

os.environ["JAX_PLATFORMS"] = "cpu"  # before jax is imported anywhere
os.environ["IPHYRE_JAX_CONFIGURE"] = "off"  # commands run in here would set what holds for the whole process
# Programs of all test processes, kept from run to run: not the user's, and gone with `make clean`.
os.environ.setdefault("IPHYRE_JAX_CACHE", str(Path(__file__).parents[1] / "build" / "test-cache"))

import jax
from hypothesis import HealthCheck, settings

jax.config.update("jax_numpy_rank_promotion", "raise")

# Speed is measured in benchmarks/; on a machine that has other work a time limit says nothing about the code.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")
