"""The former place of `storage/pretrained.py`, for one more version."""

import warnings

from iphyre_jax.train.storage.pretrained import Pretrained, load_pretrained, names

__all__ = ["Pretrained", "load_pretrained", "names"]

warnings.warn("import iphyre_jax.train.storage.pretrained instead", DeprecationWarning, stacklevel=2)
