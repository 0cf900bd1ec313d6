"""The files of registrations: what is stored is read, and what cannot be used is refused in one sentence."""

from datetime import datetime

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from common.errors import RigError
from common.poses import pose
from leap_motion.registration import PointFit, RegistrationRefused, check_serial
from leap_motion.ros.registrations import MAX_AGE_DAYS, load, registration_file, store

NOW = datetime(2026, 11, 23, 12, 0, 0).timestamp()


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))


def stored(**changes):
    """A good file with changed keys; None leaves one out."""
    store(registration_file("desk"), PointFit(np.eye(4), np.array([1e-3]), 1.0), "LP1", NOW, simulated=False)
    path = registration_file("desk")
    values = {**yaml.safe_load(path.read_text()), **changes}
    path.write_text(yaml.safe_dump({key: value for key, value in values.items() if value is not None}))
    return path


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.tuples(*[st.floats(-0.5, 0.5)] * 6), st.sampled_from(["LP12345678901", ""]), st.floats(0.0, MAX_AGE_DAYS - 0.1)
)
def test_what_is_stored_is_read(numbers, serial, days):
    T = pose(pin.exp3(np.array(numbers[:3])), numbers[3:])
    store(registration_file("desk"), PointFit(T, np.array([1e-3, 2e-3]), 1.0), serial, NOW, days > 1.0)
    found = load("desk", NOW + 86400.0 * days)
    assert_allclose(found.T_desk_leap, T, atol=1e-6)
    assert (found.serial, found.residual_mm, found.simulated) == (serial, 2.0, days > 1.0)


def test_a_file_from_before_the_key_does_not_say_how_it_was_measured():
    stored(simulated=None)
    assert load("desk", NOW).simulated is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": [0.1, float("nan"), 0.0]}, "position is"),
        ({"position": [12.0, 200.0, 3.0]}, r"each in \[-2, 2\] m"),  # millimetres
        ({"quaternion": [0.0, 0.0, 0.0, 0.0]}, "no rotation"),
        ({"quaternion": [0.0, 0.0, 0.0, 1.1]}, "no rotation"),  # scaled
        ({"quaternion": [0.0, 1.0, 0.0, 0.0]}, "by 180 deg"),
        ({"serial": "WebXR"}, "places its axes anew"),
        ({"serial": "WC-front"}, "places its axes anew"),
        ({"date": "yesterday"}, "date is 'yesterday'"),
        ({"date": "2026-01-01T00:00:00"}, f"last {MAX_AGE_DAYS} days"),
        ({"date": "2027-01-01T00:00:00"}, f"last {MAX_AGE_DAYS} days"),
        ({"date": "2027-01-01T00:00:00+00:00"}, f"last {MAX_AGE_DAYS} days"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(changes, words):
    path = stored(**changes)
    with pytest.raises(RigError, match=words) as caught:
        load("desk", NOW)
    assert str(path) in str(caught.value) and len(getattr(caught.value, "faults", [1])) == 1


@pytest.mark.parametrize("content", [b"", b"- 1\n", b"{", b"\xff\xfe\x00", None])
def test_what_is_no_such_file_is_refused(content):
    path = stored()
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)
    with pytest.raises(RigError, match="register_tracker.py desk|must be a mapping"):
        load("desk", NOW)


@pytest.mark.parametrize("name", ["../x"])
def test_a_name_that_is_none_of_a_file_is_refused(name):
    with pytest.raises(RigError, match="name of the tracker"):
        load(name, NOW)


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / ".config").write_text("a file")
    with pytest.raises(RigError, match="could not be written"):
        store(registration_file("desk"), PointFit(np.eye(4), np.zeros(3), 1.0), "", NOW, simulated=False)


@pytest.mark.parametrize("serial", ["WebXR", "WC-front"])
def test_a_tracker_whose_axes_are_placed_anew_cannot_be_registered(serial):
    with pytest.raises(RegistrationRefused, match=serial):
        check_serial(serial)
    check_serial("LP1")
    check_serial("")
