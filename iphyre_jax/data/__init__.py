"""Data sets of plays: drawn plans with their outcomes, kept as an NPZ file without pickles and a JSON manifest."""

from iphyre_jax.data.audit import known_plays, repeated_plays, shared_plays, verify
from iphyre_jax.data.collection import collect
from iphyre_jax.data.dataset import Dataset, load_dataset, save_dataset
from iphyre_jax.data.named.sets import NAMED_SETS, named_set
from iphyre_jax.data.official_files import drawn_times
from iphyre_jax.data.recipe import PlanPolicy
from iphyre_jax.data.sequences import tables

__all__ = [
    "NAMED_SETS",
    "Dataset",
    "PlanPolicy",
    "collect",
    "drawn_times",
    "known_plays",
    "load_dataset",
    "named_set",
    "repeated_plays",
    "save_dataset",
    "shared_plays",
    "tables",
    "verify",
]
