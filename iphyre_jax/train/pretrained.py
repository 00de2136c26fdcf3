"""Deprecated names of `train.storage.pretrained`."""

from iphyre_jax._deprecated import moved

_HOME = "iphyre_jax.train.storage.pretrained"
__getattr__ = moved(__name__, {name: (_HOME, name) for name in ("Pretrained", "load_pretrained", "names")})
