"""The tests of this folder compile quickly: networks are tried on a few numbers."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def quickly(few_optimisations: None) -> None:
    """Every module of this folder."""
