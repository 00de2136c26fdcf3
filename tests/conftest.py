"""What holds for every test: the CPU, and arrays of different rank never meet unsaid."""

import os

os.environ["JAX_PLATFORMS"] = "cpu"  # before jax is imported anywhere
os.environ["IPHYRE_JAX_CONFIGURE"] = "off"  # commands run in here would set what holds for the whole process

import jax

jax.config.update("jax_numpy_rank_promotion", "raise")
