"""A session of maps at home and poses at the grasp: the pairs, and the program beside a rig without devices."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml
from collection_rig import FIST, GRASP_Z, KUKA, OPEN, PuppetRig, teleop, tool
from episodes import CAMERA, CROP, DOWN, metadata
from hypothesis import given
from hypothesis import strategies as st

from common import clock
from common.camera_model import pinhole
from common.frames import TOOL_DESIRED
from common.poses import translation
from grasping.lab.dataset.episode import SHOWN
from grasping.lab.dataset.frame_buffer import KeptFrame, Optics
from grasping.lab.dataset.shown_grasp import Phase, SampleSchedule, ShownGrasp
from grasping.lab.dataset.store import decode, encode
from grasping.network.maps import Peak

OPTICS = Optics(CAMERA, CROP, CAMERA)
MAPS_HZ, POSES_HZ, CAMERA_S, LATER_S = 15.0, 30.0, 1.0 / 30.0, 0.01
"""Maps and poses a second, as the program takes them by default; how often images and tools come; how much later."""


def frame(stamp):
    return KeptFrame(
        stamp=stamp,
        depth=np.full((CROP.side, CROP.side), 900, np.uint16),
        maps=np.zeros((4, 150, 150), np.float16),
        mean=0.9,
        peak=Peak(140, 160, 0.7, 0.3, 40.0),
        T_base_camera=DOWN,
        T_base_tool_measured=tool(GRASP_Z + 0.2),
        T_base_tool_desired=np.full((4, 4), np.nan),
        finger_angles=np.full(4, np.nan),
        teleop_active=False,
    )


def run(maps, poses):
    """A whole session, at one map or pose a second: what it gives for each pose."""
    session, given = ShownGrasp(maps, poses, 1.0, 1.0), []
    for i in range(maps):
        assert session.phase is Phase.MAPS and session.taken == i and session.due(float(i))
        assert not session.add_map(frame(float(i)), OPTICS)
    for i in range(poses):
        assert session.phase is Phase.POSES and session.taken == i
        given.append(session.add_pose(float(maps + i), tool(GRASP_Z + 0.001 * i)))
    assert session.phase is Phase.DONE
    return given


@given(st.integers(1, 40), st.integers(1, 40))
def test_every_map_and_every_pose_is_used_and_the_shorter_half_is_spread_evenly(maps, poses):
    pairs = run(maps, poses)
    assert [grasp.time for _, grasp in pairs] == [maps + i for i in range(poses)]
    np.testing.assert_allclose([grasp.T_base_tool[2, 3] for _, grasp in pairs], GRASP_Z + 0.001 * np.arange(poses))
    used = [[int(row.stamp) for row in frames.rows] for frames, _ in pairs]
    assert {stamp for stamps in used for stamp in stamps} == set(range(maps))
    assert all(stamps == sorted(stamps) and stamps for stamps in used)
    assert [stamps[0] for stamps in used] == sorted(stamps[0] for stamps in used)
    counts = np.bincount([stamp for stamps in used for stamp in stamps])
    assert counts.max() - counts.min() <= 1, "maps are used equally often"
    sizes = [len(stamps) for stamps in used]
    assert max(sizes) - min(sizes) <= 1, "and poses have equally many"


@given(st.floats(0.1, 100.0), st.floats(0.0, 2e9), st.lists(st.floats(0.01, 0.5), min_size=1, max_size=200))
def test_of_a_faster_stream_as_many_a_second_are_taken_as_the_rate_says(rate, begin, gaps):
    """`gaps` between the stream's samples, in periods of the schedule."""
    schedule, taken = SampleSchedule(rate), []
    stamps = begin + np.cumsum([0.0, *gaps]) / rate
    for stamp in stamps.tolist():
        if schedule.due(stamp):
            schedule.take(stamp)
            taken.append(stamp)
    rounding = 1e-6 * max(rate, 1.0)
    periods = (np.array(taken) - begin) * rate
    late = periods - np.arange(len(taken))
    assert np.all(late > -rounding) and np.all(late <= 0.5 + rounding), "no drift"
    assert len(taken) > (stamps[-1] - begin) * rate - 0.5 - rounding


def test_after_a_pause_what_was_missed_is_not_made_up_for():
    schedule, taken = SampleSchedule(30.0), []
    for stamp in [*np.arange(0.0, 1.0, 0.001), *np.arange(5.0, 6.0, 0.001)]:
        if schedule.due(stamp):
            schedule.take(stamp)
            taken.append(stamp)
    assert len(taken) in (60, 61) and np.diff(taken).min() >= 0.5 / 30.0


def test_another_camera_drops_the_maps_before_it():
    session = ShownGrasp(3, 1, 1.0, 1.0)
    session.add_map(frame(0.0), OPTICS)
    other = pinhole("other", 640, 480, [[571.0, 0.0, 319.5], [0.0, 571.0, 239.5], [0.0, 0.0, 1.0]])
    assert session.add_map(frame(1.0), Optics(other, CROP, other))
    assert session.taken == 1 and session.phase is Phase.MAPS


def test_no_pose_comes_before_the_maps_or_after_the_end():
    session = ShownGrasp(1, 1, 1.0, 1.0)
    with pytest.raises(ValueError, match="maps"):
        session.add_pose(0.0, tool(GRASP_Z))
    session.add_map(frame(0.0), OPTICS)
    session.add_pose(1.0, tool(GRASP_Z))
    with pytest.raises(ValueError, match="done"):
        session.add_pose(2.0, tool(GRASP_Z))


def test_a_pair_is_an_episode_that_training_reads():
    ((frames, grasp),) = run(2, 1)
    T_tool_grasp, T_desired = translation(0.0, 0.0, 0.07), tool(GRASP_Z - 0.001)
    made = frames.episode(grasp, metadata(source=SHOWN), translation(0.0, 0.0, 0.106), T_tool_grasp, T_desired)
    read = decode(encode(made))
    assert read.metadata.source == SHOWN and read.held and len(read) == 2
    np.testing.assert_allclose(read.T_base_tool_closed, tool(GRASP_Z))
    np.testing.assert_allclose(read.T_base_grasp, T_desired @ T_tool_grasp)
    assert np.isnan(read.opening)


class Keyboard:
    """The program's input: a line for each Enter, until it is closed."""

    def __init__(self):
        self._lines = clock.Queue()

    def enter(self):
        self._lines.put("\n")

    def close(self):
        self._lines.put(None)

    def __iter__(self):
        return iter(self._lines.get, None)


@pytest.fixture
def keyboard():
    return Keyboard()


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "grasps"


@pytest.fixture
def program(ros, keyboard, folder, monkeypatch):
    """A function that starts the program, whose progress bars have the clock of the others."""
    import rospy

    from grasping.lab.ros import collection_setup

    monkeypatch.setattr(collection_setup, "revision", lambda _: "")
    monkeypatch.setattr("tqdm.std.time", lambda: clock.time())
    rospy.set_param("kuka", yaml.safe_load(KUKA.read_text()))
    words = ("cup", "--view", "camera", "--folder", str(folder))

    def run(*more):
        node = ros.run("grasping", "collect_shown_grasp.py", *words, *more)
        node.stdin = keyboard
        return node

    return run


@pytest.fixture
def arm(ros):
    """A function that sets the mode that the arm's controller publishes; with an empty one it is silent."""
    import rospy

    from rig_msgs.msg import KukaStatus

    publisher = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    mode = [KukaStatus.STARTING]
    rospy.Timer(rospy.Duration(0.04), lambda _: mode[0] and publisher.publish(KukaStatus(mode=mode[0])))
    return lambda name: mode.__setitem__(0, name)


@pytest.fixture
def rig(ros):
    made = PuppetRig(CAMERA_S, 1)
    yield made
    made.close()


@pytest.mark.ros
def test_maps_at_home_then_poses_while_a_hand_is_followed_each_after_enter(
    ros, program, keyboard, rig, arm, folder, monkeypatch
):
    from grasping.lab.ros.frame_reader import FrameReader

    def files():
        return sorted(folder.glob("*.npz"))

    looked, look = [], FrameReader.look
    monkeypatch.setattr(FrameReader, "look", lambda reader, placed: looked.append(placed) or look(reader, placed))
    one = program("--maps", "15", "--poses", "60")
    clock.sleep(1.0)
    assert "the arm is not at home: starting" in one.log and "silent" not in one.log
    assert not looked, "the network has no work away from home"
    arm("")
    clock.sleep(0.7)  # 0.5 s until it counts as silent
    assert "the arm's controller is silent" in one.log and "1/15" not in one.log
    arm("home")
    clock.sleep(1.2)
    assert "15/15" in one.log and "Bring the hand to the grasp" in one.log and not files()
    arm("servo")
    rig.say("/leap_kuka/state", teleop(True))
    rig.perform([(0.5, OPEN, False, GRASP_Z + 0.1, GRASP_Z), (0.2, OPEN, False, GRASP_Z, GRASP_Z)])
    assert "Enter starts" in one.log and not files(), "the tool is on its way"
    keyboard.enter()
    clock.sleep(0.5)
    said, count = len(one.log), len(files())
    assert count in (15, 16)
    rig.say("/leap_kuka/state", teleop(False))
    rig.perform([(1.0, OPEN, False, GRASP_Z, GRASP_Z + 0.1)])
    keyboard.enter()
    clock.sleep(1.0)
    assert "Enter starts" in one.log[said:] and len(files()) == count, "it pauses, and Enter alone does not end that"
    rig.say("/leap_kuka/state", teleop(True))
    rig.silent.add(TOOL_DESIRED)
    rig.perform([(1.0, FIST, False, GRASP_Z + 0.1, GRASP_Z), (0.2, FIST, False, GRASP_Z, GRASP_Z)])
    assert len(files()) == count, "also where a hand is followed again"
    keyboard.enter()
    clock.sleep(0.5)
    assert "the pose of kuka/tool_frame/des" in one.log and len(files()) == count  # the line ends where a terminal does
    rig.silent.clear()
    left = (60 - count) / POSES_HZ
    assert one.wait(left + 0.1) == 0, one.log
    *_, (taken, rate) = re.findall(r"(5\d)/60 \[[^]]* ([\d.]+)it/s", one.log)
    assert float(rate) < int(taken) / (int(taken) / POSES_HZ + 3.7), "with the pause, as it tells the time that is left"
    made = [decode(file.read_bytes()) for file in files()]
    assert len(made) == 60 and "60 poses of cup with 15 maps" in one.log
    moments = np.array([episode.t_grasp for episode in made])
    assert moments[count - 1] - moments[0] == pytest.approx((count - 1) / POSES_HZ, abs=CAMERA_S)
    assert moments[-1] - moments[count] == pytest.approx((59 - count) / POSES_HZ, abs=CAMERA_S)
    stamps = sorted({stamp for episode in made for stamp in episode.stamp})
    assert len(stamps) == 15 and stamps[-1] - stamps[0] == pytest.approx(14 / MAPS_HZ, abs=CAMERA_S)
    for episode in made:
        assert (episode.metadata.source, episode.metadata.object) == (SHOWN, "cup") and episode.held
        np.testing.assert_allclose(episode.T_base_tool_closed, tool(GRASP_Z), atol=1e-6)
        np.testing.assert_allclose(episode.T_base_grasp, tool(GRASP_Z - 0.001) @ episode.T_tool_grasp, atol=1e-6)
        np.testing.assert_allclose(episode.T_base_camera[0], DOWN, atol=1e-9)
    assert len({episode.metadata.fingerprint for episode in made}) == 1


@pytest.mark.ros
def test_what_ends_it_is_one_sentence(ros, program, keyboard, rig, arm, folder):
    one = program("--maps", "0")
    assert one.wait(LATER_S) == 2 and "--maps is 0 and must be 1 to 10000." in one.log
    one = program("--pose-rate", "nan")
    assert one.wait(LATER_S) == 2 and "--pose-rate is nan and must be 0.1 to 100 a second." in one.log
    ros.master_answers = False
    one = program()
    assert one.wait(LATER_S) == 1 and "There is no ROS master" in one.log and "Traceback" not in one.log
    ros.master_answers = True
    keyboard.close()
    arm("home")
    one = program("--maps", "1")
    assert one.wait(1.0) == 1 and "there is no keyboard" in one.log and not [*folder.glob("*.npz")]
