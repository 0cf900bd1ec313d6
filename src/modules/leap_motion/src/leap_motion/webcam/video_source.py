"""Images of a camera or a video file, always the newest, read in a thread of its own; a lost camera is tried again."""

from __future__ import annotations

import abc
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from leap_motion.webcam.lens import WebcamError

RATE_HZ = 30.0  # asked of the camera: what nearly all have
RETRY_S = 1.0
TRYING = " Trying again."
"""End of the fault of a camera that may come yet."""


@dataclass(frozen=True)
class VideoImage:
    """An image, shape (height, width, 3), blue first, and when it was taken [s, monotonic]."""

    image: np.ndarray
    stamp: float


class VideoSource(abc.ABC):
    """Reads until it is closed. `fault`: why no images come, one sentence; empty while they come."""

    def __init__(self, mirrored: bool) -> None:
        self.fault = "The camera is being opened."
        self._mirrored = mirrored
        self._newest: VideoImage | None = None
        self._changed = threading.Condition()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def newest(self, timeout: float) -> VideoImage | None:
        """Returns the newest image that was not returned before; None if none comes within `timeout` [s]."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None, timeout)
            newest, self._newest = self._newest, None
        return newest

    def close(self) -> None:
        """Ends reading; waits for the thread, two seconds at most: a camera may hang."""
        self._closing.set()
        self._thread.join(2.0)

    @abc.abstractmethod
    def _run(self) -> None:
        """Reads in the thread, until `_closing` is set."""

    def _take(self, image: np.ndarray, stamp: float) -> None:
        with self._changed:
            self.fault = ""
            self._newest = VideoImage(cv2.flip(image, 1) if self._mirrored else image, stamp)
            self._changed.notify_all()


class CameraSource(VideoSource):
    """A camera, `device` of which is a number or a path such as /dev/video0."""

    def __init__(self, device: str, mirrored: bool) -> None:
        super().__init__(mirrored)
        self._path = Path(f"/dev/video{device}" if device.isdecimal() else device)

    def _run(self) -> None:
        cv2.setLogLevel(0)  # `fault` reports what is wrong
        lost = False
        while not self._closing.is_set():
            self.fault = self._missing(lost)
            if not self.fault:
                camera = cv2.VideoCapture(str(self._path), cv2.CAP_V4L2)
                lost = self._read(camera)
                camera.release()
                busy = f"The camera {self._path} gives no images; perhaps another program uses it."
                self.fault = self._missing(lost) or busy
            self._closing.wait(RETRY_S)

    def _missing(self, lost: bool) -> str:
        if not self._path.exists():
            there = ", ".join(str(path) for path in sorted(Path("/dev").glob("video*"))) or "none"
            what = f"The camera {self._path} was unplugged" if lost else f"There is no camera {self._path}"
            return f"{what}; cameras: {there}.{TRYING}"
        if not os.access(self._path, os.R_OK | os.W_OK):
            return f"This user may not read the camera {self._path}: `sudo adduser $USER video`, then log in again."
        return ""

    def _read(self, camera: cv2.VideoCapture) -> bool:
        size_px = (640, 480)  # asked of the camera: what nearly all have
        camera.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        for key, value in ((cv2.CAP_PROP_FRAME_WIDTH, size_px[0]), (cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])):
            camera.set(key, value)
        camera.set(cv2.CAP_PROP_FPS, RATE_HZ)
        came = False
        while not self._closing.is_set():
            good, image = camera.read()
            if not good or image is None:
                return came
            came, now = True, time.monotonic()
            taken = 1e-3 * camera.get(cv2.CAP_PROP_POS_MSEC)  # by the driver's monotonic clock, where it has one
            self._take(image, taken if now - 1.0 < taken <= now else now)
        return came


class FileSource(VideoSource):
    """A video file in real time, again and again; each round slides in and ends with a pause. Raises WebcamError if
    it cannot be read."""

    def __init__(self, path: Path, mirrored: bool) -> None:
        film_hz = (5.0, 240.0)  # a film with another rate has none: some containers state 0, 1000 or 90000
        super().__init__(mirrored)
        self._video = cv2.VideoCapture(str(path))
        rate = self._video.get(cv2.CAP_PROP_FPS)
        self._period = 1.0 / (rate if film_hz[0] <= rate <= film_hz[1] else RATE_HZ)
        good, image = self._video.read()
        if not good or image is None:
            raise WebcamError(f"{path} is not a video that can be read.")
        self._first: np.ndarray = image

    def _run(self) -> None:
        pause_s = 2.0  # grey images between two rounds of a video
        entry_s = 1.5  # its first image slides in from the side, so that a hand comes in from outside of the box
        grey = 128
        due = time.monotonic()
        pause = np.full_like(self._first, grey)
        while not self._closing.is_set():
            for left in np.linspace(0.5, 0.0, round(entry_s / self._period), endpoint=False):
                shift = max(1, round(left * pause.shape[1]))
                if not self._closing.is_set():
                    due = self._pace(due, np.hstack([pause[:, :shift], self._first[:, :-shift]]))
            image: np.ndarray | None = self._first
            while image is not None and not self._closing.is_set():
                due = self._pace(due, image)
                good, image = self._video.read()
                image = image if good else None
            for _ in range(round(pause_s / self._period)):
                if not self._closing.is_set():
                    due = self._pace(due, pause)
            self._video.set(cv2.CAP_PROP_POS_FRAMES, 1)

    def _pace(self, due: float, image: np.ndarray) -> float:
        """Gives an image at `due` [s]; returns when the next one is due."""
        self._closing.wait(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        self._take(image, max(due, now - self._period))
        return max(due, now - 1.0) + self._period
