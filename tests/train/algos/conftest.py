"""The tests of this folder compile quickly."""

from collections.abc import Iterator

import jax
import pytest


@pytest.fixture(autouse=True)
def few_optimisations() -> Iterator[None]:
    """The formulae run on a few numbers here: XLA's optimisations would cost more time than they save."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
