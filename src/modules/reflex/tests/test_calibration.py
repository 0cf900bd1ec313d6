"""The calibration's records and their text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reflex.calibration import FingerZeros, TactileOffsets, calibration_text, parse_calibration
from reflex.errors import CalibrationFileError

GOLDEN = """\
# Written by the driver when the fingers are calibrated [rad].
encoder_zero_reference: [0.5, 6.28, 3.14159]
motor_zero_reference: [59, 57.1235, 58, 55.25]
"""


def test_golden_text():
    zeros = FingerZeros(np.array([0.5, 6.28, 3.14159265]), np.array([59.0, 57.123456, 58.0, 55.25]))
    assert calibration_text(zeros) == f"{GOLDEN}simulated: false\n"
    read = parse_calibration(FingerZeros, GOLDEN, "file")  # as of the maker's driver, without the key
    np.testing.assert_allclose(read.motor_zero_reference, zeros.motor_zero_reference, rtol=1e-5)


@given(st.lists(st.floats(0, 6.28), min_size=3, max_size=3), st.lists(st.floats(20, 90), min_size=4, max_size=4))
def test_zeros_come_back_to_six_digits(encoders, motors):
    text = calibration_text(FingerZeros(np.array(encoders), np.array(motors)))
    zeros = parse_calibration(FingerZeros, text, "file")
    np.testing.assert_allclose(zeros.encoder_zero_reference, encoders, rtol=5e-6)
    np.testing.assert_allclose(zeros.motor_zero_reference, motors, rtol=5e-6)


@given(st.lists(st.lists(st.integers(0, 65535), min_size=9, max_size=9), min_size=3, max_size=3))
def test_offsets_come_back(rows):
    text = calibration_text(TactileOffsets(*map(np.array, rows)))
    offsets = parse_calibration(TactileOffsets, text, "file")
    np.testing.assert_allclose(offsets.rows, rows, rtol=5e-6)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("", ""),
        ("encoder_zero_reference: [1, 2", ""),
        ("encoder_zero_reference: [1, 2, 3]", "motor_zero_reference"),
        (GOLDEN.replace("[59", "[" + ".nan"), "motor_zero_reference"),
        (GOLDEN.replace("[59", "[" + "301"), "motor_zero_reference"),
        (GOLDEN.replace("[59", "[" + "many"), "motor_zero_reference"),
        (GOLDEN.replace("[59,", "["), "motor_zero_reference"),
        (GOLDEN + "more: 1", "more"),
    ],
)
def test_a_torn_file_is_refused_by_name(text, key):
    with pytest.raises(CalibrationFileError) as error:
        parse_calibration(FingerZeros, text, "/somewhere/finger_calibrate.yaml")
    (fault,) = error.value.faults
    assert "/somewhere/finger_calibrate.yaml" in fault and key in fault
