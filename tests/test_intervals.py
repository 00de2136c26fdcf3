import math

import pytest

from iphyre_jax.intervals import mean_interval


def test_interval_holds_the_mean_and_narrows() -> None:
    few, many = mean_interval([0.0, 1.0] * 5), mean_interval([0.0, 1.0] * 50)
    assert few.value == many.value == 0.5
    assert few.low < many.low < 0.5 < many.high < few.high
    assert mean_interval([0.3] * 4) == pytest.approx((0.3, 0.3, 0.3))


def test_a_single_value_has_no_interval() -> None:
    one = mean_interval([374.2])
    assert one.value == 374.2
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    assert str(one) == "374.20 [-]"
    assert mean_interval([0.25, 0.75]).bounds(1, 100) == "[25.0, 75.0]"
