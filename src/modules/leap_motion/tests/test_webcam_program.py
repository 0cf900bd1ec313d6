"""The program webcam_leapd: what its options refuse, a camera that is missing, and a filmed hand through MediaPipe."""

import math
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from leap_motion.client import LeapClient
from leap_motion.registration import RegistrationRefused, check_serial
from leap_motion.service.server import LeapServiceError
from leap_motion.webcam import video_source, webcam_program
from leap_motion.webcam.lens import WebcamError, lens_of_calibration, lens_of_view
from leap_motion.webcam.setups import FRONT, placement
from leap_motion.webcam.video_source import CameraSource, FileSource

SCRIPT = Path(__file__).parents[1] / "scripts" / "webcam_leapd.py"


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


@pytest.mark.parametrize(("options", "code"), [([], ""), (["--host", "0.0.0.0", "--code", "secret7"], "secret7")])
def test_other_machines_are_served_with_the_code_that_is_given(monkeypatch, capsys, options, code):
    def service(*_, **given):
        raise LeapServiceError(f"the code is {given['code']!r}")

    monkeypatch.setattr(webcam_program, "HandDetector", lambda *_: None)
    monkeypatch.setattr(webcam_program, "LeapService", service)
    assert webcam_program.main(["--headless", *options]) == 1
    assert f"the code is {code!r}" in capsys.readouterr().err


def test_without_a_screen_the_program_ends_in_a_sentence(monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(webcam_program, "WebcamTracker", lambda _: pytest.fail("it begins"))
    assert webcam_program.main([]) == 1
    assert "There is no screen" in capsys.readouterr().err


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


def test_a_missing_camera_is_said_and_tried_again(monkeypatch, wait_until):
    monkeypatch.setattr(video_source, "RETRY_S", 0.01)
    source = CameraSource("/dev/no_such_camera", mirrored=False)
    source.start()
    wait_until(lambda: "There is no camera /dev/no_such_camera" in source.fault, 10.0, "the sentence")
    assert source.newest(0.1) is None
    source.close()


def test_a_camera_that_gives_nothing_is_said(monkeypatch, tmp_path, wait_until):
    monkeypatch.setattr(video_source, "RETRY_S", 0.01)
    (tmp_path / "video7").write_text("")
    source = CameraSource(str(tmp_path / "video7"), mirrored=False)
    source.start()
    wait_until(lambda: "another program" in source.fault, 10.0, "the sentence")
    assert source.newest(0.3) is None
    (tmp_path / "video7").unlink()
    wait_until(lambda: "There is no camera" in source.fault, 10.0, "that it is gone")
    source.close()


def film(path, images, rate=100.0):
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, (width, height))
    for image in images:
        writer.write(image)
    writer.release()
    return path


def test_a_film_is_played_in_real_time_and_again_after_a_pause(tmp_path, monkeypatch, wait_until):
    monkeypatch.setattr(video_source, "PAUSE_S", 0.05)
    monkeypatch.setattr(video_source, "ENTRY_S", 0.03)
    bright = [np.full((48, 64, 3), 250, np.uint8)] * 5
    source = FileSource(film(tmp_path / "a.avi", bright), mirrored=False)
    source.start()
    taken = []

    def played():
        taken.extend(filter(None, [source.newest(2.0)]))
        levels = "".join("b" if image.image.mean() > 200 else "-" for image in taken)
        return len(taken) >= 20 and "b-" in levels and "-b" in levels

    wait_until(played, 10.0, "the film, the pause and the film again", poll=0.0)
    source.close()
    stamps = [image.stamp for image in taken]
    assert all(a < b for a, b in zip(stamps, stamps[1:]))
    with pytest.raises(WebcamError, match="is not a video"):
        FileSource(Path(__file__), mirrored=False)


@pytest.mark.clock
def test_a_mirrored_camera_is_turned_back(tmp_path, monkeypatch):
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, :32] = 255
    monkeypatch.setattr(video_source, "ENTRY_S", 0.0)
    source = FileSource(film(tmp_path / "a.avi", [image] * 500), mirrored=True)  # of five seconds
    source.start()
    taken = source.newest(60.0)
    source.close()
    assert taken is not None and taken.image[:, 40:].mean() > 200 > taken.image[:, :24].mean()


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


def test_the_program_serves_empty_frames_of_a_film_without_a_hand_and_ends_in_order(tmp_path, processes, wait_until):
    pytest.importorskip("mediapipe")
    path = film(tmp_path / "grey.avi", [np.full((120, 160, 3), 128, np.uint8)] * 60, 20.0)
    program = processes.start(sys.executable, str(SCRIPT), "--video", str(path), "--headless", "--port", "0")
    wait_until(lambda: "127.0.0.1:" in program.log_path.read_text(), 30.0, "the service")
    port = program.log_path.read_text().split("127.0.0.1:")[1].split(",")[0]
    client = LeapClient("127.0.0.1", int(port))
    frames = [client.next_frame(60.0) for _ in range(3)]
    client.close()
    assert all(received is not None and not received.frame.hands for received in frames)
    assert processes.end(program) == 0
    printed = program.log_path.read_text()
    assert "No hand is seen." in printed and "from image to frame" in printed and "Traceback" not in printed
