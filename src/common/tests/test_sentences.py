"""Which sentences say the same again."""

import pytest

from common.sentences import without_numbers


@pytest.mark.parametrize("value, other", [("3", "-12"), ("0.31", "7"), ("1e+05", "2.5e-07"), ("10", "1")])
def test_values_do_not_matter_and_all_else_does(value, other):
    assert without_numbers(f"it is {value} m away") == without_numbers(f"it is {other} m away") == "it is # m away"
    assert without_numbers(f"it is {value} m away") != without_numbers(f"it is {value} s old")
