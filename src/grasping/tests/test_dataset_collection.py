"""When an episode begins and ends, and which frames it has."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from episodes import CAMERA, CROP, DOWN
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from common.config import parse
from common.poses import translation
from grasping.execution.grasp_watch import GraspWatch, GraspWatchConfig, HandMeasurement, ObservedGrasp
from grasping.lab.dataset.collector import Collector
from grasping.lab.dataset.episode import EXECUTION
from grasping.lab.dataset.frame_buffer import MAP_SIDE, FrameBufferConfig, KeptFrame, Optics, look, millimetres, on_hand
from grasping.network.depth_image import Crop
from grasping.network.maps import Peak
from grasping.pipeline.projection import project_grasp as grasp_at
from grasping.pipeline.settings import overlaid, rig_configuration, settings_from
from grasping.pipeline.view import CameraView, CropConfig

CONFIG = Path(__file__).parents[1] / "config"
YAML = yaml.safe_load((CONFIG / "collection.yaml").read_text())
WATCH = parse(GraspWatchConfig, YAML["watch"])
FRAMES = parse(FrameBufferConfig, YAML["frames"])
GGCNN_YAML = {
    **yaml.safe_load((CONFIG / "ggcnn.yaml").read_text()),
    "tool": yaml.safe_load((CONFIG / "tool_pose.yaml").read_text()),
}
GGCNN = settings_from(GGCNN_YAML)
OPTICS = Optics(CAMERA, CROP, CAMERA)
UP = np.array([0.0, 0.0, 1.0])
DRIFT = np.full((3, 9), 30.0)
OPEN = HandMeasurement(np.zeros(3), DRIFT, np.zeros(3))
FIST = HandMeasurement(np.full(3, 1.8), DRIFT + 2.0, np.full(3, 100.0))


def pressing(*fingers):
    """A fist in which some of index, middle and thumb press something with a cell."""
    return replace(FIST, pressures=FIST.pressures + 20.0 * np.eye(3, 9) * np.array(fingers)[:, None])


FULL = pressing(True, False, True)
LOW, HIGH = translation(0.5, 0.0, 0.2), translation(0.5, 0.0, 0.25)


class Hand:
    """Feeds a watch or a collector 40 times a second."""

    def __init__(self, step):
        self.step, self.now = step, 100.0

    def feed(self, state, T_base_tool, seconds):
        """Returns what came out of so many seconds."""
        found = []
        for _ in range(round(40 * seconds)):
            self.now += 0.025
            found.append(self.step(state, T_base_tool, self.now))
        return [f for f in found if f is not None]


@pytest.fixture
def hand():
    return Hand(GraspWatch(WATCH, UP).step)


PULLED = replace(FIST, loads=np.array([150.0, 0.0, 150.0]))
NOT_OPPOSED = (
    FIST,
    pressing(True, True, False),
    pressing(False, False, True),
    replace(FIST, loads=np.array([150.0, 150.0, 0.0])),
)


@pytest.mark.parametrize(
    ("phases", "held", "reason"),
    [
        ([(FULL, LOW, 2.0), (FULL, HIGH, 1.0)], True, "felt something when the tool was 50 mm higher"),
        ([(PULLED, LOW, 1.0), (PULLED, HIGH, 1.0)], True, "felt something"),
        *(([(state, LOW, 1.0), (state, HIGH, 1.0)], False, "did not both feel") for state in NOT_OPPOSED),
        ([(PULLED, LOW, 1.0), (PULLED, HIGH, WATCH.hold_time - 0.1), (FIST, HIGH, 0.5)], False, "did not both feel"),
        ([(FULL, LOW, 1.0), (OPEN, LOW, 0.1)], False, "The fingers opened before the tool was lifted."),
        ([(FULL, LOW, 1.0), (FULL, HIGH, 0.2), (OPEN, HIGH, 0.1)], False, "before it had been held long enough"),
        ([(FULL, LOW, WATCH.patience + 1.0)], False, "not lifted by 30 mm in 20 s"),
    ],
)
def test_a_grasp_is_decided_once_and_held_if_a_thumb_and_a_finger_feel_it_above(hand, phases, held, reason):
    hand.feed(OPEN, LOW, 1.0)
    *before, last = phases
    assert not [grasp for phase in before for grasp in hand.feed(*phase)]
    (grasp,) = hand.feed(*last)
    assert grasp.held == held and reason in grasp.reason
    assert grasp.time == pytest.approx(101.0 + WATCH.rest_time, abs=0.06)
    np.testing.assert_array_equal(grasp.T_base_tool, LOW)
    assert not hand.feed(*last[:2], 5.0), "the same grasp again"


def test_fingers_that_were_never_open_or_never_rest_have_not_closed(hand):
    assert not hand.feed(FULL, LOW, 3.0) + hand.feed(FULL, HIGH, 3.0), "it was closed when the node started"
    hand.feed(OPEN, LOW, 1.0)
    for i in range(100):
        restless = replace(FULL, angles=np.full(3, 1.5 + 0.1 * (i % 2)))
        assert not hand.feed(restless, LOW, 0.05)
    assert not hand.feed(replace(FULL, angles=np.array([0.0, 0.0, 1.8])), LOW, 2.0), "the thumb alone"
    assert not hand.feed(replace(FULL, angles=np.array([0.0, 0.0, 1.8])), HIGH, 2.0)


def test_up_follows_the_mounting_and_bad_numbers_are_no_state():
    hand = Hand(GraspWatch(WATCH, -UP).step)
    hand.feed(OPEN, HIGH, 1.0)
    hand.feed(FULL, HIGH, 1.0)
    assert not hand.feed(replace(FULL, angles=np.array([np.nan, 0.0, 0.0])), LOW, 2.0)
    assert not hand.feed(replace(OPEN, loads=(np.inf, 0.0, 0.0)), HIGH, 0.1)
    assert hand.feed(FULL, LOW, 1.0)[0].held


def kept(stamp, T_base_tool=LOW) -> KeptFrame:
    window = np.zeros((4, 4), np.uint16)
    maps = np.zeros((4, 2, 2), np.float16)
    fingers = np.zeros(4)
    return KeptFrame(stamp, window, maps, 1.0, Peak(0, 0, 0.0, 0.0, 0.0), DOWN, T_base_tool, T_base_tool, fingers, True)


@pytest.fixture
def collector():
    made = Collector(replace(FRAMES, most_frames=5), WATCH, UP)
    made.hand(OPEN, LOW, 0.0)
    return made


def offer(collector, stamps, camera=CAMERA):
    """Offers a frame of a moving tool at each stamp; returns the stamps of those that were kept."""
    found = []
    for stamp in stamps:
        T = translation(0.01 * stamp, 0.0, 0.2)
        if collector.due(stamp) and collector.wants(stamp, T):
            collector.add(kept(stamp, T), Optics(camera, CROP, CAMERA))
            found.append(stamp)
    return found


@given(st.lists(st.floats(0.001, 0.5), min_size=1, max_size=60), st.floats(0.0, 0.02))
@settings(max_examples=50)
def test_frames_are_thinned_by_rate_and_motion(steps, speed):
    collector = Collector(FRAMES, WATCH, UP)
    collector.hand(OPEN, LOW, 0.0)
    last = None
    for stamp in np.cumsum(steps):
        T = translation(speed * stamp, 0.0, 0.2)
        if not (collector.due(stamp) and collector.wants(stamp, T)):
            continue
        if last is not None:
            assert stamp - last >= 1.0 / FRAMES.rate - 1e-9
            assert speed * (stamp - last) >= FRAMES.motion - 1e-9
        collector.add(kept(stamp, T), OPTICS)
        last = stamp
    assert collector.kept == collector.waiting >= 1


def test_an_episode_has_the_newest_frames_up_to_the_grasp(collector):
    offer(collector, range(100, 110))
    finished = collector.outcome(ObservedGrasp(107.5, LOW, True, "Seen."))
    assert [row.stamp for row in finished.frames.rows] == [105, 106, 107]
    assert finished.source == EXECUTION and collector.waiting == 0
    assert not collector.wants(107.4, HIGH) and collector.wants(107.6, HIGH), "the next episode begins after the grasp"
    assert not collector.add(kept(107.0), OPTICS) and collector.waiting == 0


def test_frames_that_are_too_old_belong_to_no_episode(collector):
    offer(collector, [100.0, 101.0, 150.0])
    rows = collector.outcome(ObservedGrasp(100.5 + FRAMES.longest, LOW, True, "Seen.")).frames.rows
    assert [row.stamp for row in rows] == [101.0, 150.0]


def test_a_stream_or_a_proposal_begins_anew(collector):
    offer(collector, [100.0])
    collector.went_back(100.2)
    collector.stream(True)
    assert collector.waiting == 0 and collector.teleop
    collector.add(kept(100.2), OPTICS)
    assert collector.waiting == 0, "the network looked at it meanwhile"
    offer(collector, [101.0])
    collector.stream(True)
    assert collector.waiting == 1, "it began once"
    collector.stream(False)
    collector.executing(True)
    assert collector.waiting == 0
    offer(collector, [102.0])
    collector.executing(True)
    collector.stream(True)
    assert collector.waiting == 1, "the approach belongs to the episode of a proposal"


def grasped(collector, held=FULL):
    """The hand closes and lifts; returns what came out and when it closed."""
    hand = Hand(collector.hand)
    found = hand.feed(OPEN, LOW, 1.0) + hand.feed(held, LOW, 1.0) + hand.feed(held, HIGH, 1.0)
    return found


def test_frames_of_an_object_in_the_hand_belong_to_no_episode(collector):
    assert not Collector(FRAMES, WATCH, UP).wants(100.0, LOW), "nobody knows what is in a hand that was not seen"
    grasped(collector)
    assert not offer(collector, [110.0]), "it is carried"
    collector.hand(OPEN, LOW, 111.0)
    assert offer(collector, [112.0]) == [112.0]
    collector.hand(FULL, LOW, 113.0)
    collector.hand(FULL, LOW, 114.0)
    assert not offer(collector, [115.0]), "it is in the hand again"


def test_a_grasp_that_both_see_is_one_episode(collector):
    collector.executing(True)
    offer(collector, [100.0])
    assert not grasped(collector), "the outcome counts while a proposal is executed"
    assert collector.outcome(ObservedGrasp(101.2, LOW, True, "Seen.")).frames.rows
    collector.executing(False)
    assert collector.outcome(ObservedGrasp(101.9, LOW, True, "Seen again.")) is None


def test_time_that_goes_back_begins_anew(collector):
    assert not collector.went_back(100.0)
    offer(collector, [100.0])
    collector.outcome(ObservedGrasp(100.0, LOW, True, "Seen."))
    offer(collector, [101.0])
    assert not collector.went_back(100.9), "stamps of several sources are never quite in order"
    assert collector.went_back(50.0)
    collector.hand(OPEN, LOW, 50.0)
    assert collector.waiting == 0 and offer(collector, [50.0]) == [50.0]
    assert not collector.went_back(51.0)


def test_another_camera_drops_the_frames_before(collector):
    offer(collector, [100.0])
    other = replace(CAMERA, width=320)
    for stamp, optics in enumerate((Optics(other, CROP, CAMERA), Optics(other, CROP, other), OPTICS), 101):
        assert collector.add(kept(stamp), optics)
        assert collector.waiting == 1
    assert not collector.add(kept(104.0), Optics(replace(CAMERA), Crop(*CROP), CAMERA))
    assert collector.add(kept(105.0), Optics(CAMERA, Crop(0, 0, 400), CAMERA))


def test_millimetres_are_whole_and_none_is_zero():
    depth = np.array([[0.9994, 1.0006, np.nan], [np.inf, -1.0, 65.535], [0.0, 0.0003, 65.6]], np.float32)
    np.testing.assert_array_equal(millimetres(depth), [[999, 1001, 0], [0, 0, 65535], [0, 0, 0]])


def ramp(_):
    """A network whose maps rise from row to row; the best is at 0.4 of the way."""
    rows = torch.linspace(0.0, 1.0, 300)[:, None].expand(300, 300)
    return torch.stack((torch.exp(-((rows - 0.4) ** 2) * 50.0), rows, -rows, 0.5 * rows))[None]


@pytest.mark.parametrize("kind", ["camera", "table"])
def test_what_is_kept_of_a_image_is_what_the_network_saw_and_said(kind):
    views = GGCNN.views() if kind == "table" else CameraView(CropConfig(400, 0))
    depth = np.full((480, 640), 0.8, np.float32)
    depth[230:260, 310:340] = 0.7
    seen = views.step(depth, CAMERA)
    view, T_view_own = look(ramp, seen, GGCNN.steps(UP))
    assert view.depth.shape == (seen.image.crop.side,) * 2 and view.depth.dtype == np.uint16
    assert len(np.unique(view.depth)) == 2 and np.ptp(view.depth) == pytest.approx(100, abs=1)
    assert view.maps.shape == (4, MAP_SIDE, MAP_SIDE) and view.maps.dtype == np.float16
    np.testing.assert_allclose(view.maps[1][:, 0], (np.arange(150) * 2 + 0.5) / 299.0, atol=1e-3)
    np.testing.assert_allclose(view.maps[2], -view.maps[1])
    assert view.mean == pytest.approx(seen.image.mean)
    own = grasp_at(view.peak, seen.image.crop, 300, seen.depth, seen.camera)
    np.testing.assert_array_equal(T_view_own, own.T_camera_grasp)
    if kind == "camera":
        assert view.peak.row == pytest.approx(0.4 * 299, abs=1.0)
        assert 20 <= view.peak.column < 280, "no peak near the border, as the node ggcnn wants it"


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.5, 0.5))
def test_what_is_beside_or_above_the_fingers_may_be_the_robot(x, y, z):
    assume(abs(np.hypot(x, y) - FRAMES.hand_radius) > 1e-9 and abs(z - FRAMES.hand_reach) > 1e-9)
    p = DOWN @ (x, y, z, 1.0)
    robot = np.hypot(x, y) < FRAMES.hand_radius and z < FRAMES.hand_reach
    assert on_hand(p[:3], DOWN, FRAMES) == robot
    assert not on_hand(p[:3], DOWN, replace(FRAMES, hand_radius=0.0))


def test_a_network_that_says_nothing_finite_is_refused():
    view = CameraView(CropConfig(400, 0)).step(np.full((480, 640), 0.8, np.float32), CAMERA)
    with pytest.raises(ValueError, match="not finite"):
        look(lambda _: torch.full((1, 4, 300, 300), torch.nan), view, GGCNN.steps(UP))


def test_the_configuration_changes_with_each_of_its_parts_and_with_nothing_else():
    def of(kuka="LBR7R800", tool=0.1, camera=CAMERA, T_base_camera=DOWN, settings=GGCNN, weights="ab"):
        parts = {"robot": kuka}, translation(0, 0, tool), np.eye(4), camera, T_base_camera, settings, weights
        return json.dumps(rig_configuration(*parts))

    assert of() == of(T_base_camera=DOWN @ translation(1e-5, 0.0, 0.0))
    changes = {
        "kuka": "LBR14R820", "tool": 0.2, "camera": replace(CAMERA, width=320), "weights": "cd",
        "T_base_camera": DOWN @ translation(0.01, 0.0, 0.0),
    }  # fmt: skip
    different = {of(), *(of(**{name: value}) for name, value in changes.items())}
    for change in ({"view": "camera"}, {"crop": {"side": 300}}, {"table": {"extent": 0.5}}):
        different.add(of(settings=settings_from(overlaid(GGCNN_YAML, change))))
    assert len(different) == 1 + len(changes) + 3
