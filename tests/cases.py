"""Cases of a test, some of which take too long for `make test`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def further_but(cases: Iterable[Any], *kept: Any) -> list[Any]:
    """Return cases for `parametrize`; `make test-further` alone tries all but the kept ones."""
    return [pytest.param(case, marks=() if case in kept else pytest.mark.further) for case in cases]
