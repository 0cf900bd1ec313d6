"""Number texts of the server: golden vectors of Double.toString, and what Double.parseDouble takes and refuses."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_simulation.devices.sunrise import java_text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.0"),
        (-0.0, "-0.0"),
        (0.1, "0.1"),
        (1.0, "1.0"),
        (-123.0, "-123.0"),
        (120.0, "120.0"),
        (0.001, "0.001"),
        (0.00123, "0.00123"),
        (0.000999, "9.99E-4"),
        (5e-5, "5.0E-5"),
        (-1.3405321274206328e-5, "-1.3405321274206328E-5"),
        (1e7, "1.0E7"),
        (9999999.0, "9999999.0"),
        (1234567.875, "1234567.875"),
        (12345678.9, "1.23456789E7"),
        (1e22, "1.0E22"),
        (1.7976931348623157e308, "1.7976931348623157E308"),
        (5e-324, "5.0E-324"),
        (math.inf, "Infinity"),
        (-math.inf, "-Infinity"),
        (math.nan, "NaN"),
        (-0.7843743209986667, "-0.7843743209986667"),
    ],
)
def test_golden_texts(value, text):
    assert java_text.text(value) == text


@given(st.floats(1e-4, 1e8) | st.floats(0.0009, 0.0011) | st.floats(9e6, 1.1e7) | st.integers(1, 10**8).map(float))
def test_texts_are_decimal_from_a_thousandth_to_ten_million_and_scientific_beyond(value):
    _, listed, exponent = Decimal(repr(value)).as_tuple()
    digits, point = "".join(map(str, listed)).rstrip("0"), len(listed) + exponent
    if 1e-3 <= value < 1e7:
        whole, fraction = digits[: max(point, 0)].ljust(point, "0"), "0" * -point + digits[max(point, 0) :]
        assert java_text.text(value) == f"{whole or '0'}.{fraction or '0'}"
    else:
        assert java_text.text(value) == f"{digits[0]}.{digits[1:] or '0'}E{point - 1}"
    assert java_text.text(-value) == f"-{java_text.text(value)}"


def test_a_vector_ends_with_its_separator():
    assert java_text.vector([0.0, -1.5]) == "0.0_-1.5_"


@given(st.floats(allow_nan=False))
def test_every_double_comes_back_from_its_text(value):
    text = java_text.text(value)
    back = java_text.number(text)
    assert back == value
    assert math.copysign(1.0, back) == math.copysign(1.0, value)
    assert len(text) <= 24


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-0.5", -0.5),
        ("1e-3", 1e-3),
        ("1E-3", 1e-3),
        (" +2. ", 2.0),
        (".5", 0.5),
        ("1d", 1.0),
        ("1.5F", 1.5),
        ("Infinity", math.inf),
        ("-Infinity", -math.inf),
        ("0x1.8p1", 3.0),
        ("1e999", math.inf),
    ],
)
def test_what_java_reads(text, value):
    assert java_text.number(text) == value


def test_java_reads_its_own_nan():
    assert math.isnan(java_text.number("NaN"))
    assert math.isnan(java_text.number("-NaN"))


@pytest.mark.parametrize(
    "text", ["", " ", "nan", "inf", "-inf", "1,5", "1 5", "e5", ".", "abc", "1_0", "0x10", "--1", "١"]
)
def test_what_java_refuses(text):
    with pytest.raises(ValueError):
        java_text.number(text)
