"""A small data set, made once a process."""

from functools import cache

from iphyre_jax.data import Dataset, collect


@cache
def small() -> Dataset:
    """Six plays of each kind of two games, with exact poses."""
    return collect(["hole", "support"], successes=6, failures=6, sequences=True, pose_dtype="float64")
