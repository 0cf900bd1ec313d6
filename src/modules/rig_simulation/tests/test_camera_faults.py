"""Faults of the simulated camera: what becomes of its pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_simulation.devices.camera.rgbd_camera import RgbdImages
from rig_simulation.faults.camera import CAMERA_FAULTS, Exposure, ImageStream
from rig_simulation.faults.injection import Faults

BLANK = RgbdImages(None, np.full((2, 3), 7, np.uint16), np.full((2, 3), 8, np.uint16), {})


class Camera:
    """Counts its pictures; the stamp of each is the time of asking."""

    def __init__(self) -> None:
        self.faults = Faults(CAMERA_FAULTS)
        self.stream = ImageStream(self.faults)
        self.taken = 0

    def next(self, now: float) -> Exposure | None:
        def expose() -> Exposure:
            self.taken += 1
            return Exposure(dataclasses.replace(BLANK, seconds={"number": self.taken}), now)

        return self.stream.next(expose, now, now)


@pytest.fixture
def camera() -> Camera:
    return Camera()


def test_without_a_fault_every_picture_goes_out(camera):
    assert [camera.next(0.1 * i).stamp for i in range(3)] == [0.0, 0.1, 0.2]
    assert camera.taken == 3


def test_vanished_publishes_nothing_and_takes_nothing(camera):
    camera.faults.switch("vanished")
    assert camera.next(1.0) is None
    camera.faults.switch("vanished", on=False)
    assert camera.next(2.0).stamp == 2.0
    assert camera.taken == 1


@pytest.mark.parametrize("name, stamp", [("frozen", 1.0), ("stuck", 2.0)])
def test_a_camera_that_hangs_repeats_the_last_picture(camera, name, stamp):
    first = camera.next(1.0)
    camera.faults.switch(name)
    again = camera.next(2.0)
    assert (again.images, again.stamp, camera.taken) == (first.images, stamp, 1)
    camera.faults.switch(name, on=False)
    assert camera.next(3.0).images is not first.images


def test_empty_depth_leaves_the_colour(camera):
    camera.faults.switch("depth_empty")
    pictures = camera.next(1.0).images
    assert not pictures.depth.any() and not pictures.registered.any()
    assert BLANK.depth.all()


@given(height=st.integers(2, 9), width=st.integers(1, 9), pixel=st.sampled_from([2, 3, 4]))
def test_garbled_pictures_fit_neither_themselves_nor_the_camera(height, width, pixel):
    camera = Camera()
    step = width * pixel
    message = {"height": height, "width": width, "step": step, "data": bytes(height * step)}
    assert camera.stream.garbled(**message) == {}
    camera.faults.switch("garbled")
    ways = set()
    for _ in range(100):
        changed = camera.stream.garbled(**message)
        seen = {**message, **changed}
        whole = len(seen["data"]) == seen["step"] * seen["height"] and seen["step"] >= seen["width"] * pixel
        assert not whole or (seen["height"], seen["width"]) != (height, width)
        ways.add(tuple(changed))
    assert ways == {("data",), ("step",), ("width",), ("height",), ("height", "data")}


def test_a_share_of_the_pictures_is_garbled(camera):
    camera.faults.switch("garbled", value=0.25)
    count = sum(bool(camera.stream.garbled(2, 2, 4, bytes(8))) for _ in range(1000))
    assert 200 < count < 300


def test_slow_leaves_so_many_pictures_a_second(camera):
    camera.faults.switch("slow", value=2.0)
    came = [camera.next(0.125 * i) is not None for i in range(16)]
    assert came == [True, False, False, False] * 4
