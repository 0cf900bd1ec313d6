"""The program webcam_leapd: what its options refuse, a camera that is missing, and a filmed hand through MediaPipe."""

import math
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from common import clock
from leap_motion.client import LeapClient
from leap_motion.registration import RegistrationRefused, check_serial
from leap_motion.service.server import LeapServiceError
from leap_motion.webcam import video_source, webcam_program
from leap_motion.webcam.lens import WebcamError, lens_of_calibration, lens_of_view
from leap_motion.webcam.setups import FRONT, placement
from leap_motion.webcam.video_source import CameraSource, FileSource

RETRY_S, ENTRY_S, SILENCE_S = 1.0, 1.5, 0.5
"""Between two looks for a camera; of a film's way in; after which a camera counts as unplugged."""


@pytest.mark.parametrize(
    "options",
    [["--fov", "nan"], ["--fov", "500"], ["--setup", "left"], ["--palm-width", "10"], ["--hands", "3"], ["x"]],
)
def test_bad_options_end_the_program(options):
    with pytest.raises(SystemExit):
        webcam_program.parse(options)


def test_a_registration_counts_for_one_set_up_alone():
    above = ["--setup", "above"]
    others = (["--tilt", "5"], ["--distance", "500"], ["--camera", "1"], ["--video", "a.mp4"], ["--fov", "70"])
    more = (["--palm-width", "90"], ["--mirrored"], ["--person", "anna"], ["--camera-info", "a.yaml"])
    serials = [webcam_program.serial_of(webcam_program.parse([*above, *options])) for options in ([], *others, *more)]
    assert len(set(serials)) == len(serials) and max(map(len, serials)) < 32
    assert serials[0] == webcam_program.serial_of(
        webcam_program.parse([*above, "--headless", "--port", "0", "--code", "secret7"])
    )
    with pytest.raises(RegistrationRefused):
        check_serial(webcam_program.serial_of(webcam_program.parse([])))


def test_what_roslaunch_adds_is_left_out():
    assert webcam_program.parse(["__name:=leapd", "--tilt", "-20"]).tilt == -20.0


@pytest.mark.parametrize(
    ("options", "given"),
    [([], "code '', own None"), (["--host", "0.0.0.0", "--code", "secret77"], "code 'secret77', own 'tracker'")],
)
def test_other_machines_are_served_with_the_code_that_is_given(monkeypatch, capsys, options, given):
    def service(*_, **given):
        raise LeapServiceError(f"code {given['code']!r}, own {given['certificate']!r}")

    monkeypatch.setattr(webcam_program, "HandDetector", lambda *_: None)
    monkeypatch.setattr(webcam_program, "own_certificate", lambda folder: folder.name)
    monkeypatch.setattr(webcam_program, "LeapService", service)
    assert webcam_program.main(["--headless", *options]) == 1
    assert given in capsys.readouterr().err


def test_other_machines_are_told_how_to_reach_it(monkeypatch, capsys):
    own = SimpleNamespace(fingerprint=lambda: 64 * "f")
    served = SimpleNamespace(host="127.0.0.1", port=6437, secure_port=6436, run=lambda: None, stop=lambda: None)
    monkeypatch.setattr(webcam_program, "HandDetector", lambda *_: None)
    monkeypatch.setattr(webcam_program, "own_certificate", lambda _: own)
    monkeypatch.setattr(webcam_program, "LeapService", lambda *_, **__: served)
    tracker = webcam_program.WebcamTracker(webcam_program.parse(["--host", "0.0.0.0", "--code", "secret77"]))
    assert f"leap_port:=6436 leap_fingerprint:={64 * 'f'}" in tracker.invitation
    assert "secret77" not in tracker.invitation


def test_without_a_screen_the_program_ends_in_a_sentence(monkeypatch, capsys):
    monkeypatch.setattr(webcam_program, "WebcamTracker", lambda _: pytest.fail("it begins"))
    assert webcam_program.main([], lambda: "DISPLAY is not set") == 1
    assert "DISPLAY is not set" in capsys.readouterr().err


class TestPersons:
    @pytest.fixture(autouse=True)
    def home(self, tmp_path, monkeypatch):
        monkeypatch.setattr(Path, "home", lambda: tmp_path)
        self.folder = tmp_path / ".config" / "leap_rig" / "palms"
        self.folder.mkdir(parents=True)

    def width(self, name="anna"):
        return webcam_program._width(webcam_program.parse(["--person", name]))

    def test_the_stored_width_is_used(self):
        (self.folder / "anna.yaml").write_text("palm_width: 78.5  # [mm]\n")
        assert self.width() == 78.5

    @pytest.mark.parametrize(
        "text", ["", "[1]", "palm_width: true", "palm_width: .nan", "palm_width: 850", "{", "a: 1"]
    )
    def test_a_file_that_is_none_is_named(self, text):
        (self.folder / "anna.yaml").write_text(text)
        with pytest.raises(WebcamError, match=r"anna\.yaml"):
            self.width()

    def test_an_unknown_person_and_a_name_that_is_a_path(self):
        (self.folder / "bert.yaml").write_text("palm_width: 90")
        with pytest.raises(WebcamError, match="known: bert"):
            self.width()
        with pytest.raises(WebcamError, match="must be letters"):
            self.width("../x")


def test_a_calibration_gives_the_same_rays_for_every_size():
    matrix = [600.0, 0.0, 330.0, 0.0, 605.0, 235.0, 0.0, 0.0, 1.0]
    values = {
        "image_width": 640,
        "camera_matrix": {"data": matrix},
        "distortion_coefficients": {"data": [0.1, -0.05, 0, 0, 0]},
    }
    lens, points = lens_of_calibration(values), np.array([[0.5, 0.5], [0.1, 0.9]])
    np.testing.assert_allclose(lens.rays(points, (480, 640, 3)), lens.rays(points, (240, 320, 3)))
    rays = lens.rays(points, (480, 640))
    np.testing.assert_allclose(lens.landmarks(np.c_[rays, [1, 1]], (480, 640)), points, atol=1e-4)
    for broken in (
        {},
        None,
        {**values, "image_width": 0},
        {**values, "camera_matrix": {"data": [math.nan] * 9}},
        {**values, "distortion_coefficients": {"data": [0.1, 0.1, 0.0]}},
        {**values, "distortion_model": "equidistant"},
    ):
        with pytest.raises(WebcamError):
            lens_of_calibration(broken)


@pytest.fixture
def virtual(wires, monkeypatch):
    for module in (video_source, webcam_program):
        for name in ("threading", "time"):
            monkeypatch.setattr(module, name, clock)


def test_a_missing_camera_is_said_and_tried_again(virtual, tmp_path):
    camera = tmp_path / "video7"
    source = CameraSource(str(camera), mirrored=False)
    source.start()
    assert source.newest(0.1) is None
    assert f"There is no camera {camera}" in source.fault
    camera.write_text("")  # that gives nothing
    clock.sleep(RETRY_S - 0.2)
    assert "There is no camera" in source.fault
    clock.sleep(0.2)
    assert "another program" in source.fault and source.newest(0.3) is None
    camera.unlink()
    clock.sleep(RETRY_S)
    assert "There is no camera" in source.fault
    source.close()


def film(path, images, rate=100.0):
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, (width, height))
    for image in images:
        writer.write(image)
    writer.release()
    return path


def test_a_film_slides_in_and_is_played_in_real_time_and_again_after_a_pause(virtual, tmp_path):
    bright = [np.full((48, 64, 3), 250, np.uint8)] * 5
    source = FileSource(film(tmp_path / "a.avi", bright), mirrored=False)
    begun = clock.monotonic()
    source.start()
    taken = [source.newest(1.0) for _ in range(150 + 5 + 200 + 150)]
    source.close()
    assert [image.stamp - begun for image in taken] == pytest.approx(0.01 * np.arange(505), abs=1e-6)
    levels = [image.image.mean() for image in taken]
    assert levels[:150] == sorted(levels[:150]) and levels[0] < 200 < levels[149]
    assert all(level > 240 for level in levels[150:155]) and all(level < 130 for level in levels[155:355])
    assert levels[355:] == pytest.approx(levels[:150])
    with pytest.raises(WebcamError, match="is not a video"):
        FileSource(Path(__file__), mirrored=False)


@pytest.mark.parametrize("rate", [1.0, 1000.0])
def test_a_film_whose_file_states_no_rate_of_a_camera_is_played_at_30_hz(virtual, tmp_path, rate):
    """Reported in https://github.com/opencv/opencv-python/issues/322, https://github.com/opencv/opencv/pull/5600:
    films state 1000, 90000 or NaN frames a second. Tried: such a film.
    """
    source = FileSource(film(tmp_path / "a.avi", [np.full((48, 64, 3), 250, np.uint8)] * 5, rate), mirrored=False)
    source.start()
    taken = [source.newest(2.0) for _ in range(60)]
    source.close()
    assert np.diff([image.stamp for image in taken]) == pytest.approx(np.full(59, 1.0 / 30.0), abs=1e-6)


def test_a_mirrored_camera_is_turned_back(virtual, tmp_path):
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, :32] = 255
    source = FileSource(film(tmp_path / "a.avi", [image] * 5), mirrored=True)
    source.start()
    clock.sleep(ENTRY_S + 0.025)
    taken = source.newest(0.0)
    source.close()
    assert taken is not None and taken.image[:, 40:].mean() > 200 > taken.image[:, :24].mean()


def test_the_program_serves_a_film_as_it_plays_and_ends_in_order(virtual, tmp_path, monkeypatch, capsys):
    handlers, came = {}, []
    monkeypatch.setattr(webcam_program, "signal", SimpleNamespace(SIGINT=2, SIGTERM=15, signal=handlers.__setitem__))
    monkeypatch.setattr(webcam_program, "HandDetector", lambda _: SimpleNamespace(find=lambda *_: []))
    path = film(tmp_path / "grey.avi", [np.full((120, 160, 3), 128, np.uint8)] * 60, 20.0)

    def watch():
        clock.sleep(0.1)
        client = LeapClient(runtime=clock)
        came.extend(client.next_frame(1.0).frame for _ in range(40))
        came.append(client.status)
        client.close()
        handlers[2]()

    clock.Thread(target=watch).start()
    assert webcam_program.main(["--video", str(path), "--headless"]) == 0
    *frames, status = came
    assert np.diff([frame.timestamp_us for frame in frames]) == pytest.approx(np.full(39, 50_000), abs=2)
    assert not any(frame.hands for frame in frames)
    assert status.service == "2.3.1+webcam" and status.serial == "WC-front"
    assert status.simulated, "nobody's hand is before the camera now"
    out, err = capsys.readouterr()
    assert "listening on 127.0.0.1:6437, set-up front" in out and "from image to frame" in out
    assert "No hand is seen." in err


def test_without_images_the_tracker_counts_as_unplugged(virtual, monkeypatch, capsys):
    monkeypatch.setattr(webcam_program, "HandDetector", lambda _: None)
    tracker = webcam_program.WebcamTracker(webcam_program.parse(["--camera", "/dev/no_such_camera", "--headless"]))
    tracker.start()
    client = LeapClient(runtime=clock)
    clock.sleep(SILENCE_S + 0.09)  # the client looks every 0.1 s
    assert "not plugged in" not in client.status.sentence
    clock.sleep(0.1)
    assert "not plugged in" in client.status.sentence
    client.close()
    tracker.stop()
    assert "There is no camera /dev/no_such_camera" in capsys.readouterr().err


def test_a_filmed_hand_is_a_right_one_in_the_box(shared_data):
    pytest.importorskip("mediapipe")
    from leap_motion.webcam.hand_detector import HandDetector
    from leap_motion.webcam.hand_tracks import HandTracks

    video = cv2.VideoCapture(str(shared_data / "hands" / "human_hand_video.mp4"))
    detector, tracks, found = HandDetector(single=True), HandTracks(placement(FRONT), 85.0), []
    for i in range(50):
        image = cv2.resize(video.read()[1], (640, 360))
        seen = detector.find(image, lens_of_view(math.radians(60.0), image.shape))
        found.append(tracks.step(seen, float(image.mean()), i / 15.0))
    hands = [f.hands[0] for f in found if f.hands]
    assert len(hands) >= 45 and {hand.side for hand in hands} == {"right"}
    followed = [hand for hand in hands if hand.confidence > 0.3]
    assert len(followed) >= 10
    for hand in followed:
        assert np.abs(hand.palm - [0, 350, 0]).max() < 100.0
        assert hand.direction[2] < -0.7 and hand.normal[1] < -0.7
