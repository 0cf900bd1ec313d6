"""The calibration's files: whole or not there at all."""

import errno
import os

import numpy as np
import pytest

from reflex.calibration_files import CalibrationFiles
from reflex.errors import CalibrationFileError


@pytest.fixture
def files(tmp_path):
    return CalibrationFiles(str(tmp_path / "hand"))


def test_what_was_saved_is_loaded(files, shipped):
    zeros, offsets, calibrated = files.load()
    assert not calibrated
    np.testing.assert_array_equal(zeros.motor_zero_reference, shipped[0].motor_zero_reference)
    np.testing.assert_array_equal(zeros.encoder_zero_reference, shipped[0].encoder_zero_reference)
    np.testing.assert_array_equal(offsets.tactile_offset_f3, shipped[1].tactile_offset_f3)
    files.save(zeros)
    assert files.save(offsets).read_text().count("[") == 4
    assert files.load()[2]


@pytest.mark.parametrize("of_simulation", [True, False, None])
@pytest.mark.parametrize("simulated", [True, False])
def test_a_real_hand_takes_no_calibration_of_the_simulated_one(shipped, tmp_path, of_simulation, simulated):
    """None: a file of the maker's driver, or from before the key."""
    for calibration in shipped:
        file = CalibrationFiles(str(tmp_path), simulated=bool(of_simulation)).save(calibration)
        if of_simulation is None:
            file.write_text("".join(line for line in file.open() if "simulated" not in line))
    here = CalibrationFiles(str(tmp_path), simulated=simulated)
    if of_simulation and not simulated:
        with pytest.raises(CalibrationFileError, match=f"{tmp_path}/finger_calibrate.yaml is of the simulated hand"):
            here.load()
    else:
        assert here.load()[2]
    first = tmp_path / "finger_calibrate.yaml"
    first.write_text(first.read_text().partition("simulated")[0] + "simulated: perhaps\n")
    with pytest.raises(CalibrationFileError, match="must be true or false"):
        here.load()


def test_a_file_that_cannot_be_read(files):
    (files.folder / "finger_calibrate.yaml").mkdir(parents=True)
    with pytest.raises(CalibrationFileError):
        files.load()


def test_a_full_disk_leaves_the_old_file_and_no_other(files, shipped, monkeypatch):
    path = files.save(shipped[0])
    before = path.read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CalibrationFileError, match="No space left on device"):
        files.save(shipped[0])
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["finger_calibrate.yaml"]
