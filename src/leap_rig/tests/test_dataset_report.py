"""The report on a dataset: what is refused, by name, and what is far from the other episodes."""

import base64
import json
import math
import re
from html.parser import HTMLParser
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from recordings import START, stored, write_recording

from common.poses import pose
from leap_rig.recording import quality
from leap_rig.recording.quality import EpisodeQuality, QualityFault, QualityLimits
from leap_rig.recording.quality_page import page, worst_first
from leap_rig.recording.recording_files import RecordingFault
from leap_rig.recording.session import EpisodeLabel, episode_folder, write_label

COLOR, JOINTS = "/camera/rgb/image_raw", "/kuka/joint_positions"


def rows(state, action=None, fps=10):
    """Rows of an arm; `state`: shape (n, 7)."""
    names = tuple(f"kuka_joint_{i}" for i in range(1, 8))
    return SimpleNamespace(
        names=names, times=np.arange(len(state)) / fps, state=state, action=state if action is None else action
    )


def test_a_joint_is_frozen_where_its_goal_moves():
    moving = np.tile(0.05 * np.arange(30)[:, None], (1, 7))
    stuck = moving.copy()
    stuck[12:18, 3] = stuck[12, 3]
    assert quality.frozen_joints(rows(moving), 10, 0.5) == []
    assert quality.frozen_joints(rows(stuck, moving), 10, 0.5) == [("kuka_joint_4", 1.2)]
    assert quality.frozen_joints(rows(stuck, moving), 10, 0.6) == []
    assert quality.frozen_joints(rows(stuck, stuck), 10, 0.5) == [], "it was not sent anywhere"


def test_pauses_count_between_the_motions():
    state = np.zeros((60, 7))
    state[:, 2] = np.interp(np.arange(60), [10, 14, 25, 30, 32, 40], [0.0, 0.4, 0.4, 0.9, 0.9, 1.7])
    count, seconds = quality.stalls(rows(state), 10)
    assert count == 1 and seconds == pytest.approx(1.1), "neither the ends nor 0.2 s"
    assert quality.stalls(rows(np.zeros((21, 7))), 10) == (1, 2.0)


def test_a_hand_is_lost_between_its_first_and_its_last_frame():
    hands, fresh = np.array([0, 1, 1, 0, 1, 1, 0, 0]), np.zeros(8)
    assert quality.lost_fraction(hands, fresh) == pytest.approx(0.2)
    silent = np.where(np.arange(8) == 2, 0.3, 0.0)
    assert quality.lost_fraction(hands, silent) == pytest.approx(0.4)
    assert quality.lost_fraction(np.zeros(8), fresh) is None and quality.lost_fraction(hands, fresh - 1.0) is None


def test_jerk_is_that_of_the_motion():
    t = quality.GRID_S * np.arange(200)
    track = np.column_stack([0.1 * t**3, np.zeros_like(t), np.ones_like(t)])
    assert quality.rms_jerk(track) == pytest.approx(0.6, rel=1e-6)
    assert quality.rms_jerk(track[:10]) is None


def test_missing_images_are_counted_by_their_usual_distance():
    stamps = 10**8 * np.delete(np.arange(20), [5, 6])
    rate, missing = quality._rate_and_missing(stamps)
    assert rate == pytest.approx(10.0) and missing == pytest.approx(0.1)
    assert quality._rate_and_missing(stamps[:1]) == (0.0, 0.0)


def known(name, said="success", rates=(("/a", 30.0),), **measures):
    return EpisodeQuality(name, EpisodeLabel(said), measures, rates=dict(rates))


def test_outliers_are_named_among_five_and_more():
    many = [known(str(i), duration=10.0 + 0.5 * (i % 3)) for i in range(6)] + [known("long", duration=30.0)]
    quality.compare(many, QualityLimits())
    assert [one.name for one in many if one.outliers == ["duration"]] == ["long"]
    few = [known(str(i), duration=10.0) for i in range(3)] + [known("long", duration=30.0)]
    quality.compare(few, QualityLimits())
    assert not any(one.outliers for one in few)


def test_rates_and_signals_of_all_episodes_are_the_same():
    ones = [known(str(i)) for i in range(4)]
    ones += [known("slow", rates=[("/a", 20.0)]), known("more", rates=[("/a", 30.0), ("/b", 1.0)])]
    ones += [known("less", rates=[("/c", 1.0)])]
    assert quality.compare(ones, QualityLimits())[0] == []
    found = {one.name: {fault.name for fault in one.faults} for one in ones if one.faults}
    assert found == {"slow": {"mixed-rates"}, "more": {"other-signals"}, "less": {"other-signals"}}


def test_a_dataset_needs_a_success_and_several_starts():
    faults, remarks = quality.compare([known("0", "failure"), known("1", "failure")], QualityLimits())
    assert [fault.name for fault in faults] == ["no-success"] and len(remarks) == 1
    alike = [known(str(i)) for i in range(3)]
    for one in alike:
        one.starts["tool"] = (0.5, 0.0, 0.3)
    assert any("one place" in remark for remark in quality.compare(alike, QualityLimits())[1])
    alike[0].starts["tool"] = (0.52, 0.0, 0.3)
    assert not any("one place" in remark for remark in quality.compare(alike, QualityLimits())[1])
    assert quality.spread_of_starts(alike)["tool"] == pytest.approx(0.02 * math.sqrt(2) / 3)


class _Tags(HTMLParser):
    """Checks that a page closes what it opens, and names the addresses that it loads."""

    def __init__(self):
        super().__init__()
        self.open, self.loaded, self.text = [], [], ""

    def handle_starttag(self, tag, attributes):
        self.loaded += [value for name, value in attributes if name in ("src", "href")]
        if tag not in ("meta", "img", "input", "br", "circle", "polyline"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in ("circle", "polyline"):
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_page_stands_alone_and_escapes_what_it_shows():
    one = known("<b>episode", duration=2.0, delay=90.0)
    one.refuse("nan", "3 < 4 rows")
    one.cameras["<color>"] = quality.CameraQuality(3, 10.0, 0.0, 5.0, 50.0, 3, COLOR, (10.0, 12.0))
    one.speed = np.linspace(0.0, 0.2, 1000)
    other = known("second", duration=4.0)
    for i, each in enumerate((one, other)):
        each.starts["<cup>"] = (0.5, 0.1 * i, 0.2)
    films = {1: {}, 0: {"<color>": (b"one", b"two")}}
    text = page([one, other], [QualityFault("no-success", "none < all")], ["Said & done."], films)
    parsed = _Tags()
    parsed.feed(text)
    assert parsed.open == [] and all(value.startswith("data:image/jpeg;base64,") for value in parsed.loaded)
    for said in ("<b>episode", "3 < 4 rows", "<color>: 3 images", "<cup> at the start", "none < all", "Said & done."):
        assert said in parsed.text
    assert "Not fit for training: 1 episodes are refused." in parsed.text
    assert 'data-every="500"' in text, "two images of 2 s, twice as fast"


def test_those_with_most_faults_come_first_then_those_with_most_outliers():
    ones = [known(str(i)) for i in range(5)]
    ones[1].outliers, ones[3].outliers = ["jerk"], ["jerk", "path"]
    ones[2].refuse("nan", "3 rows")
    assert worst_first(ones) == [2, 3, 1, 0, 4]


def test_an_empty_report_is_a_page():
    assert "Fit for training" in page([known("0")], [], [], {})


def episode(folder, change=lambda found: found, label="success", seconds=3.0):
    """An episode in which the arm follows a hand before a camera; `change` gets a list of topics, messages, times."""
    import rospy
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header
    from tf2_msgs.msg import TFMessage

    from common.ros.conversions import stamped_transform
    from kuka_msgs.msg import jointPositions
    from leap_motion.msg import RawFrame
    from rig_msgs.msg import KukaStatus, SentGoals

    noise = np.random.default_rng(int(folder.name[-2:])).integers(0, 255, (int(10 * seconds), 48, 64, 3), np.uint8)
    found = []
    for i in range(int(100 * seconds)):
        t = 0.01 * i
        stamp = rospy.Time(0, START) + rospy.Duration.from_sec(t)
        q = [0.3 * math.sin(2.0 * t + j) for j in range(7)]
        tool = pose(np.eye(3), (0.5 + 0.1 * math.sin(2.0 * t), 0.001 * int(folder.name[-2:]), 0.3))
        edge = stamped_transform(tool, "kuka/base_frame", "kuka/tool_frame/measured", stamp)
        hand = {"id": 7, "confidence": 1.0, "palmPosition": [100.0 * math.sin(2.0 * t), 200.0, 0.0]}
        found += [
            (JOINTS, jointPositions(Header(0, stamp, ""), *q), t),
            ("/kuka/sent_goals", SentGoals([stamp], q, [0.0]), t),
            ("/tf", TFMessage([edge]), t),
            ("/leap_motion/raw_frames", RawFrame(stamp, json.dumps({"hands": [hand]})), t),
            ("/kuka/status", KukaStatus(), t),
        ]
        if i % 10 == 0:
            found.append((COLOR, Image(Header(0, stamp, ""), 48, 64, "rgb8", 0, 192, noise[i // 10].tobytes()), t))
    write_recording(folder, [stored(*one) for one in change(found)], name="x", task="lift the cup")
    if label is not None:
        write_label(folder, EpisodeLabel(label))
    return folder


def of(topic, edit):
    """Returns a change of all messages of a topic; `edit` returns a message, or None to leave it out."""

    def change(found):
        return [
            (name, message if name != topic else edit(message, t), t)
            for name, message, t in found
            if name != topic or edit(message, t) is not None
        ]

    return change


def _joint(value, begin=1.0):
    def edit(message, t):
        message.joint_2 = value if t >= begin else message.joint_2
        return message

    return edit


def _limited(message, _):
    message.limited_by = ["joint speed"]
    return message


def _pixels(value):
    def edit(message, _):
        message.data = value * 48
        return message

    return edit


def _stamped_back(message, t):
    import rospy

    if t >= 1.0:
        message.header.stamp = rospy.Time.from_sec(message.header.stamp.to_sec() - 0.5)
    return message


def _no_hand(message, t):
    message.text = '{"hands": []}' if 1.0 <= t < 2.5 else message.text
    return message


def _bad_frame(message, _):
    message.text = '{"hands": [3, {"palmPosition": "x"}], "a": NaN}'
    return message


POISON = {
    "nan": of(JOINTS, _joint(math.nan)),
    "frozen-joints": of(JOINTS, _joint(0.1)),
    "limited": of("/kuka/status", _limited),
    "empty-camera": of(COLOR, _pixels(b"\x05" * 192)),
    "frozen-camera": of(COLOR, _pixels(b"\x05" * 96 + b"\xff" * 96)),
    "missing-images": of(COLOR, lambda message, t: None if 0.5 < t < 2.0 else message),
    "time-back": of(COLOR, _stamped_back),
    "no-rows": of(JOINTS, lambda *_: None),
    "tracking-lost": of("/leap_motion/raw_frames", _no_hand),
}


def names(folder, limits=None):
    return {fault.name for fault in quality.episode_quality(folder, 20, limits or QualityLimits()).faults}


@pytest.mark.ros
@pytest.mark.parametrize("name", POISON)
def test_what_would_spoil_a_training_is_refused_by_name(tmp_path, name):
    assert names(episode(tmp_path / "episode_00001", POISON[name])) == {name}


@pytest.mark.ros
def test_while_a_policy_leads_no_hand_need_be_seen(tmp_path):
    from rig_msgs.msg import TeleopState

    def led(found):
        states = [("/leap_kuka/state", TeleopState(state="holding", hold="led"), 0.2 * i) for i in range(15)]
        return sorted(POISON["tracking-lost"](found) + states, key=lambda one: one[2])

    assert names(episode(tmp_path / "episode_00001", led)) == set()


@pytest.mark.ros
def test_a_good_episode_is_refused_nothing_and_measured(tmp_path):
    found = quality.episode_quality(episode(tmp_path / "episode_00001", seconds=8.0), 20, QualityLimits())
    assert found.faults == [] and set(quality.MEASURES) == set(found.measures) and found.rates.keys() >= {COLOR, JOINTS}
    assert found.measures["duration"] == pytest.approx(8.0, abs=0.1) and found.measures["stalls"] == 0.0
    assert found.measures["path"] == pytest.approx(1.0, abs=0.05), "0.1 m to and fro, five times"
    assert found.measures["delay"] == pytest.approx(0.0, abs=10.0)
    assert found.measures["lost"] == found.measures["limited"] == found.measures["missing"] == 0.0
    assert found.starts["tool"] == pytest.approx((0.5, 0.001, 0.3), abs=1e-3)
    camera = found.cameras["color"]
    assert (camera.count, camera.distinct, camera.topic) == (80, 80, COLOR)


@pytest.mark.ros
def test_what_is_short_unlabelled_or_set_back_is_refused(tmp_path):
    assert names(episode(tmp_path / "episode_00001", label=None)) == {"no-label"}
    assert names(episode(tmp_path / "episode_00002", label="unfinished")) == {"no-label"}
    assert names(episode(tmp_path / "episode_00003", seconds=0.8)) == {"too-short"}
    assert names(tmp_path / "episode_00003", QualityLimits(shortest=0.1)) == set()
    back = episode(
        tmp_path / "episode_00004", lambda found: found[:800] + [(*one[:2], one[2] - 1.0) for one in found[800:]]
    )
    assert names(back) == {"time-back"}
    assert names(episode(tmp_path / "episode_00005", of("/leap_motion/raw_frames", _bad_frame))) == set()
    (tmp_path / "episode_00001" / "messages.mcap").write_bytes(b"")
    assert names(tmp_path / "episode_00001") == {"unreadable"}
    (tmp_path / "episode_00002" / "label.yaml").write_text("[")
    assert names(tmp_path / "episode_00002") == {"unreadable"}


def reported(*arguments):
    from leap_rig.recording.ros.dataset_report_program import _parser, report

    return report(_parser().parse_args([*map(str, arguments)]))


@pytest.mark.ros
def test_a_session_is_reported_and_the_exit_code_says_whether_it_is_fit(tmp_path, capsys):
    session, file = tmp_path / "cups", tmp_path / "report.html"
    for number, label in enumerate(("success", "failure", "discarded")):
        episode(episode_folder(session, number), label=label)
    assert reported(f"{session}/", "--page", file) == 0
    assert "2 episodes, 0 refused" in capsys.readouterr().out and "episode_00001" in file.read_text()
    assert reported(f"{session}/", "--page", file, "--shortest", "60") == 1
    assert "episode_00001: too-short: it lasts 3.00 s." in capsys.readouterr().out
    assert reported(session / "episode_00001", "--page", file) == 1
    assert "no-success: no episode is a success" in capsys.readouterr().out
    with pytest.raises(Exception, match="neither a recording nor a session"):
        reported(tmp_path, "--page", file)


def films_of(text):
    """Returns the films of a page: for each its images, decoded."""
    found = re.findall(r'<script type="application/json">(.*?)</script>', text)
    return [[_decoded(base64.b64decode(image)) for image in json.loads(one)] for one in found]


def _decoded(image):
    return cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)


def _brighter(message, t):
    message.data = bytes([round(60 * t), 0, 0]) * (48 * 64)
    return message


@pytest.mark.ros
def test_the_worst_are_shown_in_films_from_begin_to_end(tmp_path):
    session, file = tmp_path / "cups", tmp_path / "report.html"
    episode(episode_folder(session, 0))
    episode(episode_folder(session, 1), of(COLOR, _brighter), label=None)
    reported(session, "--page", file, "--worst", "1")
    (film,) = films_of(file.read_text())
    assert {image.shape for image in film} == {(120, 160, 3)}
    red = [float(image[..., 2].mean()) for image in film]
    np.testing.assert_allclose(np.diff(red), 60 * quality.FILM_S, atol=7.0)
    assert red[0] < 7.0 and red[-1] > 160.0
    reported(session, "--page", file, "--worst", "0")
    assert films_of(file.read_text()) == []


@pytest.mark.ros
def test_a_long_film_has_its_images_farther_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(quality, "MOST_IMAGES", 5)
    folder = episode(tmp_path / "episode_00001", of(COLOR, _brighter))
    camera = quality.episode_quality(folder, 20, QualityLimits()).cameras["color"]
    red = [float(_decoded(image)[..., 2].mean()) for image in quality.film(folder, camera)]
    assert len(red) == 5 and red[0] < 7.0 and red[-1] > 160.0


@pytest.mark.ros
def test_an_image_that_cannot_be_shown_costs_the_film_and_not_the_page(tmp_path, monkeypatch):
    def spoiled(*_):
        raise RecordingFault("another encoding")
        yield

    folder, file = episode(tmp_path / "episode_00001"), tmp_path / "report.html"
    judged = quality.camera_quality

    def then_spoiled(*arguments):
        found = judged(*arguments)
        monkeypatch.setattr(quality, "images", spoiled)
        return found

    monkeypatch.setattr(quality, "camera_quality", then_spoiled)
    assert reported(folder, "--page", file) == 0
    assert films_of(file.read_text()) == [] and "episode_00001" in file.read_text()


@pytest.mark.parametrize("limit", ["-1", "nan", "2", "x"])
@pytest.mark.ros
def test_an_impossible_limit_is_refused(limit, capsys):
    with pytest.raises(SystemExit):
        reported("x", "--limited", limit)
    assert "--limited" in capsys.readouterr().err
