"""Numbers of any type are compared as Python's floats are."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from iphyre_jax.checks import check_fps, check_least, check_positive, check_real

NARROW = [np.float16, np.float32, np.float64, float]


@pytest.mark.parametrize("kind", NARROW)
def test_infinity_is_no_finite_number_in_any_type(kind: Any) -> None:
    for check in (lambda v: check_positive("x", v), lambda v: check_least("x", v, 0), check_fps):
        for value in ("inf", "-inf", "nan"):
            with pytest.raises(ValueError, match=r"^(x|fps): expected [^\n]*$"):
                check(kind(value))
    assert check_real("x", kind("inf")) == np.inf


@pytest.mark.parametrize("kind", [*NARROW, np.int8, int])
def test_an_ordinary_number_passes_without_a_warning(kind: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = [
            check_positive("x", kind(15)),
            check_least("x", kind(15), 0),
            check_fps(kind(15)),
            check_real("x", kind(15)),
        ]
    assert found == [15.0] * 4
    assert {type(value) for value in found} == {float}


def test_a_huge_integer_is_none() -> None:
    for check in (lambda v: check_positive("x", v), lambda v: check_least("x", v, 0), lambda v: check_real("x", v)):
        with pytest.raises(ValueError, match="got an integer of 4001 bits"):
            check(2**4000)
