"""A session of maps at home and poses at the grasp: the pairs, and the program beside a rig without devices."""

from __future__ import annotations

import re
import subprocess
import threading

import numpy as np
import pytest
import yaml
from collection_rig import FIST, GRASP_Z, KUKA, OPEN, PuppetRig, stream, tool
from episodes import CAMERA, CROP, DOWN, metadata
from hypothesis import given
from hypothesis import strategies as st

from common.camera_model import pinhole
from common.poses import translation
from grasping.lab.dataset.episode import SHOWN
from grasping.lab.dataset.frame_buffer import KeptFrame, Optics
from grasping.lab.dataset.shown_grasp import Phase, ShownGrasp
from grasping.lab.dataset.store import decode, encode
from grasping.network.maps import Peak

OPTICS = Optics(CAMERA, CROP, CAMERA)
LONG_S = 60.0
PROGRAM = ("rosrun", "grasping", "collect_shown_grasp.py", "cup", "--view", "camera", "--folder")


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
    session, given = ShownGrasp(maps, poses, 1.0), []
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


@given(st.floats(0.1, 30.0), st.floats(0.0, 1e9), st.floats(0.0, 20.0))
def test_no_more_than_the_rate_is_taken(rate, begin, later):
    session = ShownGrasp(2, 1, rate)
    session.add_map(frame(begin), OPTICS)
    assert session.due(begin + later) == (begin + later - begin >= 1.0 / rate)


def test_another_camera_drops_the_maps_before_it():
    session = ShownGrasp(3, 1, 1.0)
    session.add_map(frame(0.0), OPTICS)
    other = pinhole("other", 640, 480, [[571.0, 0.0, 319.5], [0.0, 571.0, 239.5], [0.0, 0.0, 1.0]])
    assert session.add_map(frame(1.0), Optics(other, CROP, other))
    assert session.taken == 1 and session.phase is Phase.MAPS


def test_no_pose_comes_before_the_maps_or_after_the_end():
    session = ShownGrasp(1, 1, 1.0)
    with pytest.raises(ValueError, match="maps"):
        session.add_pose(0.0, tool(GRASP_Z))
    session.add_map(frame(0.0), OPTICS)
    session.add_pose(1.0, tool(GRASP_Z))
    with pytest.raises(ValueError, match="done"):
        session.add_pose(2.0, tool(GRASP_Z))


def test_a_pair_is_an_episode_that_training_reads():
    ((frames, grasp),) = run(2, 1)
    made = frames.episode(grasp, metadata(source=SHOWN), translation(0.0, 0.0, 0.106), np.eye(4))
    read = decode(encode(made))
    assert read.metadata.source == SHOWN and read.held and len(read) == 2
    np.testing.assert_allclose(read.T_base_tool_closed, tool(GRASP_Z))
    assert np.isnan(read.opening)


class Program:
    """The program with a keyboard, what it printed so far, and its folder."""

    def __init__(self, folder, *arguments):
        self.process = subprocess.Popen(
            [*PROGRAM, str(folder), *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        self.folder, self._read = folder, b""
        threading.Thread(target=self._loop, daemon=True).start()

    @property
    def said(self):
        return self._read.decode()

    def enter(self):
        self.process.stdin.write(b"\n")
        self.process.stdin.flush()

    def files(self):
        return sorted(self.folder.glob("*.npz"))

    def _loop(self):
        while part := self.process.stdout.read1(4096):
            self._read += part


@pytest.fixture
def program(ros, tmp_path):
    """A function that starts the program, and ends it with the test."""
    import rospy

    rospy.set_param("kuka", yaml.safe_load(KUKA.read_text()))
    started = []

    def start(*arguments):
        started.append(Program(tmp_path / "grasps", *arguments))
        return started[-1]

    yield start
    for one in started:
        one.process.kill()
        one.process.wait(LONG_S)


@pytest.fixture
def arm(ros):
    """A function that sets the mode that the arm's controller publishes."""
    import rospy

    from rig_msgs.msg import KukaStatus

    publisher = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    mode = [KukaStatus.STARTING]
    timer = rospy.Timer(rospy.Duration(0.04), lambda _: publisher.publish(KukaStatus(mode=mode[0])))
    yield lambda name: mode.__setitem__(0, name)
    timer.shutdown()
    publisher.unregister()


@pytest.fixture
def rig(ros):
    made = PuppetRig()
    yield made
    made.close()


@pytest.mark.ros
def test_maps_at_home_then_poses_while_a_hand_is_followed_each_after_enter(program, rig, arm, wait_until):
    one = program("--maps", "3", "--poses", "25")
    wait_until(lambda: "the arm is not at home: starting" in one.said, LONG_S, "that it waits for home")
    assert "1/3" not in one.said
    arm("home")
    wait_until(lambda: "Bring the hand to the grasp" in one.said, LONG_S, "the maps")
    assert "3/3" in one.said and not one.files()
    arm("servo")
    rig.say("/leap_kuka/stream", stream(True))
    # The tool stays for a while: Enter comes by another way than its pose.
    rig.perform([(0.5, OPEN, False, GRASP_Z + 0.1, GRASP_Z), (2.0, OPEN, False, GRASP_Z, GRASP_Z)])
    wait_until(lambda: "Enter starts" in one.said, LONG_S, "that it waits for Enter")
    assert not one.files(), "the tool is on its way"
    one.enter()
    wait_until(lambda: len(one.files()) >= 2, LONG_S, "poses")
    said = len(one.said)
    rig.say("/leap_kuka/stream", stream(False))
    wait_until(lambda: "Enter starts" in one.said[said:], LONG_S, "that it pauses")
    count = len(one.files())
    rig.perform([(1.0, OPEN, False, GRASP_Z, GRASP_Z + 0.1)])
    assert len(one.files()) == count < 25, "it pauses"
    rig.say("/leap_kuka/stream", stream(True))
    rig.perform([(1.0, FIST, False, GRASP_Z + 0.1, GRASP_Z), (2.0, FIST, False, GRASP_Z, GRASP_Z)])
    one.enter()
    wait_until(lambda: one.process.poll() is not None, LONG_S, "the end of the program")
    assert one.process.returncode == 0, one.said
    (rate, *_) = re.findall(r"24/25 \[[^]]* ([\d.]+)it/s", one.said)
    assert float(rate) < 6.0, "by which the time that is left is estimated; 5 poses a second are taken"
    made = [decode(file.read_bytes()) for file in one.files()]
    assert len(made) == 25 and "25 poses of cup with 3 maps" in one.said
    for episode in made:
        assert (episode.metadata.source, episode.metadata.object) == (SHOWN, "cup") and episode.held
        np.testing.assert_allclose(episode.T_base_tool_closed, tool(GRASP_Z), atol=1e-6)
        np.testing.assert_allclose(episode.T_base_camera[0], DOWN, atol=1e-9)
    assert len({episode.metadata.fingerprint for episode in made}) == 1


@pytest.fixture
def without_keyboard(ros, processes, tmp_path):
    """A function that starts the program without a keyboard, in the environment with these changes."""
    import rospy

    rospy.set_param("kuka", yaml.safe_load(KUKA.read_text()))
    return lambda *arguments, **env: processes.start(*PROGRAM, str(tmp_path / "grasps"), *arguments, env=env)


@pytest.mark.ros
def test_a_count_out_of_range_and_a_missing_master_are_one_sentence_each(without_keyboard):
    one = without_keyboard("--maps", "0")
    assert one.wait(LONG_S) == 2 and "--maps is 0 and must be 1 to 10000." in one.log_path.read_text()
    one = without_keyboard(ROS_MASTER_URI="http://localhost:9")
    assert one.wait(LONG_S) == 1
    assert "does not answer" in one.log_path.read_text() and "Traceback" not in one.log_path.read_text()


@pytest.mark.ros
def test_without_a_keyboard_it_says_so(without_keyboard, rig, arm, tmp_path):
    one = without_keyboard("--maps", "1")
    arm("home")
    assert one.wait(LONG_S) == 1, one.log_path.read_text()
    assert "there is no keyboard" in one.log_path.read_text() and not [*(tmp_path / "grasps").glob("*.npz")]
