"""The program webcam_leapd: a camera or a video, MediaPipe, and the WebSocket of a Leap service."""

from __future__ import annotations

import argparse
import math
import re
import signal
import sys
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from leap_motion.service import wire
from leap_motion.service.access import is_loopback
from leap_motion.service.certificate import CertificateError, own_certificate
from leap_motion.service.server import LeapService, LeapServiceError
from leap_motion.webcam.hand_detector import HandDetector
from leap_motion.webcam.hand_tracks import HandTracks
from leap_motion.webcam.lens import WebcamError, WebcamLens, lens_of_calibration, lens_of_view
from leap_motion.webcam.palm_width import CARD_MM, NARROWEST_MM, WIDEST_MM, agreed, find_card, find_tag, palm_width
from leap_motion.webcam.setups import FRONT, SETUPS, CameraPlacement, placement
from leap_motion.webcam.video_source import TRYING, CameraSource, FileSource, VideoImage, VideoSource

NAME = "webcam_leapd"
SERVICE = "2.3.1+webcam"
SILENCE_S = 0.5  # without an image the camera counts as unplugged
NUMBERS = re.compile(r"\d+")
LETTERS = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*", re.ASCII)


@dataclass(frozen=True)
class TrackerView:
    """What the window shows."""

    image: np.ndarray | None
    lens: WebcamLens | None
    camera: CameraPlacement
    known: bool  # whether the position of the box is known
    landmarks: list[np.ndarray]
    remark: str
    rate: float = 0.0
    distances: list[float] = field(default_factory=list)


class WebcamTracker:
    """Serves the hands of a source until it is stopped."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._source = _source(options)
        self._lens_for = _lenses(options)
        place = placement(options.setup, math.radians(options.tilt), options.distance)
        self._tracks = HandTracks(place, _width(options))
        self._detector = HandDetector(options.hands == 1)
        own = None if is_loopback(options.host) else own_certificate(_folder() / "tracker")
        self._service = LeapService(
            options.host,
            options.port,
            version=SERVICE,
            serial=serial_of(options),
            code=options.code,
            certificate=own,
            secure_port=options.secure_port,
            simulated=options.video is not None,
        )
        self.address = f"{self._service.host}:{self._service.port}"
        self.invitation = ""
        if own is not None:
            args = f"leap_port:={self._service.secure_port} leap_fingerprint:={own.fingerprint()}"
            self.invitation = f"Other machines reach it by leap_host:=ADDRESS {args} leap_code:=CODE."
        self.view = TrackerView(None, None, place, False, [], "The camera is being opened.")
        self._renew = self._stopping = False
        self._told = ""
        self._told_at = -math.inf
        self.delays: deque[float] = deque(maxlen=100_000)
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._service.run, self._track)]

    def start(self) -> None:
        self._source.start()
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Ends the threads; waits some seconds at most."""
        self._stopping = True
        self._source.close()
        self._service.stop()
        for thread in self._threads:
            thread.join(2.0)

    def renew(self) -> None:
        self._renew = True

    @property
    def alive(self) -> bool:
        return all(thread.is_alive() for thread in self._threads)

    def _track(self) -> None:
        start, number, plugged = time.monotonic(), 0, True
        while not self._stopping:
            taken = self._source.newest(SILENCE_S)
            if taken is None:
                if plugged and not self._stopping:
                    self._service.plug(False)
                plugged = False
                self._tell(self._source.fault or f"The camera sends no images.{TRYING}", None)
                continue
            if not plugged:
                self._service.plug(True)
            plugged, number = True, number + 1
            self._see(taken, number, start)

    def _see(self, taken: VideoImage, number: int, start: float) -> None:
        if self._renew:
            self._renew = False
            self._tracks.renew()
        lens = self._lens_for(taken.image.shape)
        seen = self._detector.find(taken.image, lens)
        found = self._tracks.step(seen, float(taken.image[::8, ::8].mean()), taken.stamp)
        text = wire.frame(found.hands, found.rate).text(number, 1_000_000 + round(1e6 * (taken.stamp - start)))
        self._service.offer(text)
        self.delays.append(time.monotonic() - taken.stamp)
        landmarks, camera = [hand.landmarks for hand in seen], self._tracks.camera
        known = self._tracks.centred
        self._tell(
            found.remark,
            TrackerView(taken.image, lens, camera, known, landmarks, found.remark, found.rate, found.distances),
        )

    def _tell(self, remark: str, view: TrackerView | None) -> None:
        between_lines_s = 2.0
        self.view = view or TrackerView(None, None, self._tracks.camera, False, [], remark)
        now = time.monotonic()
        if (kind := NUMBERS.sub("", remark)) != self._told and now - self._told_at > between_lines_s:
            self._told, self._told_at = kind, now
            print(f"{NAME}: {remark or 'The hand is tracked.'}", file=sys.stderr, flush=True)


def main(arguments: list[str] | None = None, no_window: Callable[[], str] = str) -> int:
    """Runs the program; returns its exit code. `no_window` returns why no window can be shown, empty if one can."""
    options = parse(arguments)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    try:
        if options.measure:
            return _measure(options, stopped)
        if not options.headless and (fault := no_window()):
            raise WebcamError(f"The window is not opened: {fault}. Start with --headless.")
        tracker = WebcamTracker(options)
    except (WebcamError, LeapServiceError, CertificateError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    print(f"{NAME}: listening on {tracker.address}, set-up {options.setup}", flush=True)
    if tracker.invitation:
        print(f"{NAME}: {tracker.invitation}", flush=True)
    tracker.start()
    if options.headless:
        while tracker.alive and not stopped.wait(0.2):
            pass
    else:
        _show(tracker, stopped, options.setup == FRONT)
    alive = tracker.alive
    tracker.stop()
    if tracker.delays:
        middle, late = np.percentile(1e3 * np.array(tracker.delays), [50, 95])
        print(f"{NAME}: {len(tracker.delays)} frames, {middle:.0f} ms (95 %: {late:.0f} ms) from image to frame.")
    return 0 if alive else 1


def _show(tracker: WebcamTracker, stopped: threading.Event, mirror: bool) -> None:
    from python_qt_binding.QtCore import QTimer
    from python_qt_binding.QtWidgets import QApplication

    from leap_motion.webcam.webcam_window import WebcamWindow

    application = QApplication([NAME])
    window = WebcamWindow(lambda: tracker.view, tracker.renew, mirror)
    timer = QTimer()
    timer.timeout.connect(lambda: None if tracker.alive and not stopped.is_set() else application.quit())
    timer.start(200)
    window.show()
    application.exec_()


def _measure(options: argparse.Namespace, stopped: threading.Event) -> int:
    measure_s = 5.0
    give_up_s = 30.0
    path = _palm_file(options.measure)
    find, size = (find_tag, (options.tag, options.tag)) if options.tag else (find_card, CARD_MM)
    scale = f"the tag of {options.tag:g} mm" if options.tag else "a bank card"
    source, lens_for, detector = _source(options), _lenses(options), HandDetector(single=True)
    source.start()
    print(
        f"{NAME}: hold your open hand flat, and {scale} beside it in the same plane, for {measure_s:g} s.", flush=True
    )
    widths: deque[tuple[float, float]] = deque()
    end = time.monotonic() + give_up_s
    width: float | None = None
    while width is None and time.monotonic() < end and not stopped.is_set():
        taken = source.newest(SILENCE_S)
        corners = None if taken is None else find(taken.image)
        if taken is None or corners is None:
            continue
        lens = lens_for(taken.image.shape)
        height, wide = taken.image.shape[:2]
        hands = detector.find(taken.image, lens)
        found = (
            palm_width(lens.rays(corners / [wide, height], taken.image.shape), size, hands[0].rays) if hands else None
        )
        if found is not None:
            widths.append((taken.stamp, found))
            while taken.stamp - widths[0][0] > measure_s:
                widths.popleft()
            if taken.stamp - widths[0][0] > 0.9 * measure_s:
                width = agreed([value for _, value in widths])
    source.close()
    if width is None:
        seen = f"Hand and {scale} were seen together in {len(widths)} images, or not flat."
        what = source.fault.replace(TRYING, "") or seen
        raise WebcamError(f"The palm could not be measured. {what} Nothing was stored.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"palm_width: {width:.1f}  # [mm] across the knuckles\n")
    except OSError as error:
        raise WebcamError(f"{path} could not be written: {error.strerror}.") from error
    print(f"{NAME}: the palm is {width:.0f} mm wide, stored in {path}. Start with --person {options.measure}.")
    return 0


def serial_of(options: argparse.Namespace) -> str:
    """Returns the serial by which a registration knows the tracker again: another one for all that changes its axes."""
    if options.setup == FRONT:
        return f"WC-{FRONT}"  # each neutral pose places its axes anew
    parts = options.video or options.camera, options.mirrored, options.fov, options.camera_info, options.tilt
    size = options.distance, options.person or options.palm_width
    return f"WC-{options.setup}-{zlib.crc32(repr((*map(str, parts), *map(str, size))).encode()):08x}"


def _palm_file(name: str) -> Path:
    if not LETTERS.fullmatch(name):
        raise WebcamError(
            f"The name is {name!r}, but must be letters, digits, - and _, and begin with a letter or digit."
        )
    return _folder() / "palms" / f"{name}.yaml"


def _folder() -> Path:
    try:
        return Path.home() / ".config" / "leap_rig"
    except RuntimeError as error:
        raise WebcamError("HOME is not set, and this user has no home: set HOME.") from error


def _width(options: argparse.Namespace) -> float:
    if not options.person:
        return options.palm_width
    path = _palm_file(options.person)
    try:
        width = yaml.safe_load(path.read_text(encoding="utf-8"))["palm_width"]
    except OSError as error:
        known = ", ".join(sorted(file.stem for file in path.parent.glob("*.yaml"))) or "nobody"
        raise WebcamError(f"There is no {path}; known: {known}. `--measure {options.person}` makes it.") from error
    except Exception as error:  # not yaml, of which the library may raise anything, or no mapping
        raise WebcamError(f"{path} holds no palm_width. `--measure {options.person}` makes it anew.") from error
    if isinstance(width, bool) or not isinstance(width, (int, float)) or not NARROWEST_MM < width < WIDEST_MM:
        raise WebcamError(f"palm_width in {path} is {width!r}, not between {NARROWEST_MM:g} and {WIDEST_MM:g} mm.")
    return float(width)


def _source(options: argparse.Namespace) -> VideoSource:
    if options.video is not None:
        return FileSource(options.video, options.mirrored)
    return CameraSource(options.camera, options.mirrored)


def _lenses(options: argparse.Namespace) -> Any:
    if options.camera_info is None:
        return lambda shape: lens_of_view(math.radians(options.fov), shape)
    try:
        values = yaml.safe_load(options.camera_info.read_text(encoding="utf-8"))
    except Exception as error:  # yaml's constructors raise anything
        raise WebcamError(f"{options.camera_info} cannot be read: {error}.") from error
    lens = lens_of_calibration(values)
    return lambda shape: lens


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Returns the options of the command line; roslaunch's name:=value are left out."""
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="A webcam as a Leap service.")
    add = parser.add_argument
    add("--camera", default="0", metavar="N", help="number or path of the camera, 0")
    add("--video", type=Path, metavar="FILE", help="a video instead of the camera, in real time, repeated")
    add("--setup", choices=tuple(SETUPS), default=FRONT, help="camera in front of you, or above the desk")
    add("--mirrored", action="store_true", help="the images are those of a mirror")
    add("--fov", type=_between(20.0, 150.0), default=60.0, metavar="DEG", help="the camera's angle of view, 60 deg")
    add(
        "--camera-info",
        type=Path,
        metavar="YAML",
        help="the camera's calibration instead, as camera_calibration stores it",
    )
    add("--tilt", type=_between(-60.0, 60.0), default=0.0, metavar="DEG", help="how far it looks up, 0 deg")
    add("--distance", type=_between(200.0, 1000.0), metavar="MM", help="from the camera to the middle of the box")
    add("--palm-width", type=_between(NARROWEST_MM, WIDEST_MM), default=85.0, metavar="MM", help="of your hand, 85 mm")
    add("--person", default="", metavar="NAME", help="whose palm --measure has stored")
    add("--measure", default="", metavar="NAME", help="measure your palm beside a bank card, store it, and exit")
    add("--tag", type=_between(10.0, 500.0), metavar="MM", help="measure beside a 36h11 tag of this size instead")
    add("--hands", type=int, choices=(1, 2), default=1, help="how many to follow; two take twice the processor time")
    add("--port", type=int, default=6437, help="WebSocket port for this machine; 0 takes any free one")
    add("--host", default="127.0.0.1", help="address to serve other machines on as well; needs a code")
    add("--code", default="", help="for programs on other machines: leap_driver's parameter code")
    add("--secure-port", type=int, default=6436, help="for other machines: port for TLS; 0 takes any free one")
    add("--headless", action="store_true", help="no window")
    given = sys.argv[1:] if arguments is None else arguments
    return parser.parse_args([argument for argument in given if ":=" not in argument])


def _between(low: float, high: float) -> Any:
    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number between {low:g} and {high:g}")
        return value

    return convert
