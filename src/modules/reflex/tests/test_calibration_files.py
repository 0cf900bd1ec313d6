"""The calibration's files: whole or not there at all."""

import errno
import os

import numpy as np
import pytest

pytestmark = pytest.mark.ros


@pytest.fixture
def files(tmp_path):
    from reflex.ros.calibration_files import CalibrationFiles

    return CalibrationFiles(str(tmp_path / "hand"))


def test_what_was_saved_is_loaded(files, shipped):
    zeros, offsets, calibrated = files.load()
    assert not calibrated
    np.testing.assert_array_equal(zeros.motor_zero_reference, shipped[0].motor_zero_reference)
    files.save_zeros(zeros)
    assert files.save_offsets(offsets).read_text().count("[") == 4
    assert files.load()[2]


def test_a_full_disk_leaves_the_old_file_and_no_other(files, shipped, tmp_path, monkeypatch):
    from common.errors import DeviceError

    path = files.save_zeros(shipped[0])
    before = path.read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DeviceError, match=r"No space left on device; the calibration holds until the driver ends\."):
        files.save_zeros(shipped[0])
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["finger_calibrate.yaml"]
