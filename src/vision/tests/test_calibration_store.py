"""The folder of calibrations: what is written is whole or not there, and torn files never count."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hand_eye_scene import SD, scene

from common.config import parse
from common.errors import ConfigError, DeviceError
from common.poses import pose
from common.stored_time import utc
from vision.calibration.hand_eye import CalibrationView
from vision.calibration.record import LIVE, CalibrationRecord

pytest.importorskip("rig_msgs.srv")
from common import clock
from vision.ros.calibration.calibration_setup import CalibrationSetup, CalibrationStore, StoreConfig, read

pytestmark = pytest.mark.ros


@pytest.fixture
def store(tmp_path):
    config = StoreConfig(str(tmp_path / "new" / "folder"), "1234", "LBR7R800", "MF_elektrisch")
    return CalibrationStore(config, simulated=False)


@pytest.fixture
def record():
    _, _, views = scene(1, 4, SD)
    return CalibrationRecord(
        "2026-01-31T12:00:00", LIVE, "LBR7R800", "MF_elektrisch", "tag_frame", "1234", "camera_rgb_optical_frame",
        0.5, 0.1, 0.2, False, pose(p=(1.0, 2.0, 3.0)), np.eye(4), np.ones((4, 2)), tuple(views),
    )  # fmt: skip


def test_the_newest_of_this_arm_and_camera_counts(store, record):
    assert store.newest() is None
    store.save(record)
    newest = store.save(replace(record, date="2026-02-01T08:00:00", rms_mm=0.25))
    store.save(replace(record, date="2026-02-02T08:00:00", camera="another"))
    store.save(replace(record, date="2026-02-03T08:00:00", robot="LBR14R820"))
    found, file = store.newest()
    assert (file, found.rms_mm) == (newest, 0.25)
    assert isinstance(found.views[0], CalibrationView)
    assert newest.name == "camera_place_2026-02-01T080000.yaml"


def dated(store, record, *dates):
    """Stores calibrations of these dates; returns their files."""
    return [store.save(replace(record, date=date)) for date in dates]


@pytest.mark.parametrize(
    ("dates", "newest"),
    [
        (("2026-10-25T00:30:00Z", "2026-10-25T02:50:00"), 1),  # as it was stored before: the time of this zone
        (("2026-10-25T02:30:00", "2026-10-25T02:10:00Z"), 1),
        (("2026-01-31T13:00:00+02:00", "2026-01-31T12:00:00Z", "2026-01-31T12:30:00"), 1),
        (("2025-12-31T23:59:59Z", "2026-01-01T00:00:00Z"), 1),
    ],
)
def test_the_newest_is_so_in_every_time_zone(store, record, monkeypatch, dates, newest):
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    try:
        assert dated(store, record, *dates)[newest] == store.newest()[1]
        setup = CalibrationSetup(*[SimpleNamespace(frame="", robot="", flange="", camera="")] * 5, False)
        assert utc(clock.time())[:15] == setup.head["date"][:15] and setup.head["date"].endswith("Z")
    finally:
        monkeypatch.undo()
        time.tzset()


@pytest.mark.parametrize("rig", [True, False, None])
@pytest.mark.parametrize("made", [True, False, None])
def test_a_simulated_calibration_is_refused_where_the_camera_is_not_known_to_be_simulated(store, record, made, rig):
    """The newest counts or nothing: an older one is no substitute that nobody asked for."""
    store.save(record)
    file = store.save(replace(record, date="2026-02-01T08:00:00", simulated=made))
    assert read(file).simulated is made and ("simulated" in yaml.safe_load(file.read_text())) is (made is not None)
    here = CalibrationStore(store._config, rig)
    if made and not rig:
        with pytest.raises(DeviceError, match=str(file)):
            here.newest()
    else:
        assert here.newest()[1] == file


def test_a_file_from_before_the_key_is_known_by_the_simulated_cameras_serial_number(store, record):
    for camera, made in (("simulated", True), ("1234", None)):
        assert read(store.save(replace(record, simulated=None, camera=camera))).simulated is made


@pytest.mark.parametrize(
    ("camera", "arm", "made"),
    [
        (False, "172.31.1.147", False), (False, "127.0.0.1", True), (True, "172.31.1.147", True), (False, "", None),
        (None, "172.31.1.147", None), (None, "localhost", True),
    ],
)  # fmt: skip
def test_camera_and_arm_are_both_real_or_the_calibration_is_not(camera, arm, made):
    assert CalibrationSetup(*[None] * 5, camera).measured_by(arm) is made


def test_a_copy_under_another_name_counts_by_its_date(store, record):
    older, newer = dated(store, record, "2026-01-31T12:00:00Z", "2026-02-01T12:00:00Z")
    newer = newer.rename(newer.with_name("camera_place_0.yaml"))
    older.rename(older.with_name("camera_place_zzz.yaml"))
    assert store.newest()[1] == newer


@pytest.mark.parametrize("damage", ["half", "empty", "binary", "other"])
def test_a_torn_file_does_not_count(store, record, damage):
    good = store.save(record)
    torn = store.save(replace(record, date="2026-02-01T08:00:00"))
    content = torn.read_bytes()
    torn.write_bytes(
        {"half": content[: len(content) // 2], "empty": b"", "binary": b"\xff\xfe\x00", "other": b"a: 1"}[damage]
    )
    assert store.newest()[1] == good
    with pytest.raises((ConfigError, DeviceError)):
        read(torn)


def test_a_full_disk_leaves_no_file_and_the_old_one_whole(store, record, monkeypatch):
    good = store.save(record)

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DeviceError, match="space"):
        store.save(replace(record, date="2026-02-01T08:00:00"))
    assert [file.name for file in store.folder.iterdir()] == [good.name]
    assert yaml.safe_load(good.read_text())["date"] == record.date


def test_a_relative_folder_is_refused():
    """A node's working folder is not the user's."""
    with pytest.raises(ConfigError, match="folder"):
        parse(StoreConfig, {"folder": "calibrations", "camera": "1", "robot": "LBR7R800", "flange": "MF_elektrisch"})


def test_a_folder_that_cannot_be_made(store, record, tmp_path):
    (tmp_path / "new").write_text("a file in the way")
    with pytest.raises(DeviceError, match="folder"):
        store.save(record)
    assert store.newest() is None
