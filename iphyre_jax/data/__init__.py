"""Data sets of plays: drawn plans with their outcomes, kept as an NPZ file without pickles and a JSON manifest."""

from iphyre_jax.data.collection import collect
from iphyre_jax.data.dataset import Dataset, load_dataset, save_dataset

__all__ = ["Dataset", "collect", "load_dataset", "save_dataset"]
