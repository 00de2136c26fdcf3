"""Learning to play: settings, networks, algorithms, evaluation and run folders. Needs the extra `train`."""

from importlib.util import find_spec

from iphyre_jax.checks import missing_extra

for _package in ("flax", "matplotlib", "optax", "orbax", "rich", "scipy"):
    if find_spec(_package) is None:
        raise missing_extra(__name__, "train", _package)
