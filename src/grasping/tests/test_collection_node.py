"""The node grasp_collection: episodes from live topics, and what is wrong with them or with its parameters."""

import os
import re
import resource
import signal

import numpy as np
import pytest
import yaml
from collection_rig import (
    CONFIG,
    FIST,
    GRASP_Z,
    IMAGE_EVERY,
    KUKA,
    OPEN,
    TICK_S,
    PuppetRig,
    grasp,
    teleop,
    tool,
)
from episodes import DOWN

from common import clock
from common.errors import RigError
from grasping.lab.dataset.episode import EXECUTION, TELEOPERATION
from grasping.lab.dataset.labels import relative_label
from grasping.lab.dataset.store import decode

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_srvs.srv import SetBool

from common.ros.conversions import stamped_pose
from grasp_msgs.msg import GraspOutcome
from grasping.lab.ros import collection_setup
from grasping.lab.ros.collection_setup import read_setup

pytest.importorskip("rospy")

pytestmark = pytest.mark.ros

STATUS_S = 0.6
"""After which diagnostics say what is so now."""
LATER_S = 0.01
"""How much later messages come and go."""
SILENT_S = 1.0
"""After which a sensor counts as silent."""


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "grasps"


@pytest.fixture
def parameters(folder):
    """The package's parameters with changes to them."""

    def changed(**changes):
        values = {
            **yaml.safe_load((CONFIG / "collection.yaml").read_text()),
            "ggcnn": {"view": "camera", "network": {}, "tool": {}},
            "folder": str(folder), "object": "cup", "operator": "puppet",
        }  # fmt: skip
        for key, value in changes.items():
            *sections, name = key.split("__")
            below = values
            for section in sections:
                below = below[section]
            below[name] = value
        return values

    return changed


@pytest.fixture
def start(ros, parameters, monkeypatch):
    """Starts the node with the parameters, and lets it listen; its revision is made up."""
    monkeypatch.setattr(collection_setup, "revision", lambda folder: f"that of {folder.name}")

    def run(**changes):
        rospy.set_param("grasp_collection", parameters(**changes))
        rospy.set_param("kuka", yaml.safe_load(KUKA.read_text()))
        process = ros.run("grasping", "collect.py")
        clock.sleep(STATUS_S)
        return process

    return run


@pytest.fixture
def rig(ros):
    made = PuppetRig()
    yield made
    made.close()


@pytest.fixture
def status(ros):
    """A function that gives the message and the values of the node's last status."""
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        found = [s for array in arrays for s in array.status if s.name == "grasp_collection"]
        values = {v.key: v.value for v in found[-1].values} if found else {}
        return {"level": found[-1].level, "message": found[-1].message, **values} if found else {"message": ""}

    return read


def files(folder):
    return sorted(folder.glob("*.npz"))


def test_a_person_who_grasps_makes_an_episode_and_may_take_it_back(rig, start, status, folder):
    process = start()
    assert status()["message"] == "0 episodes, 0 held"
    rig.say("/leap_kuka/state", teleop(True))
    rig.perform(grasp())
    (file,) = files(folder)
    made = decode(file.read_bytes())
    assert made.held and made.metadata.source == TELEOPERATION
    assert (made.metadata.object, made.metadata.operator) == ("cup", "puppet")
    assert made.metadata.configuration["kuka"]["robot"] == "LBR7R800"
    assert made.metadata.revision == "that of grasping"
    np.testing.assert_allclose(made.T_base_tool_closed, tool(GRASP_Z), atol=1e-6)
    np.testing.assert_allclose(made.T_base_grasp[:3, 3], (0.52 - 0.0152, -0.4, GRASP_Z - 0.07), atol=1e-6)
    np.testing.assert_allclose(made.T_base_camera, np.tile(DOWN, (len(made), 1, 1)), atol=1e-9)
    assert len(made) >= 2 and made.teleop_active.all()
    moved = np.diff(made.T_base_tool_measured[:, 2, 3])
    assert np.all(moved <= -0.005 + 1e-9), "the tool went down between frames"
    np.testing.assert_allclose(
        made.T_base_tool_desired[:, :3, 3], made.T_base_tool_measured[:, :3, 3] - (0.0, 0.0, 0.001), atol=1e-6
    )
    np.testing.assert_array_equal(made.depth[0], rig.depth[40:440, 120:520])
    assert np.isfinite(made.finger_angles).all() and relative_label(made.frame(0)) is not None
    assert status()["message"] == "1 episodes, 1 held"
    log = process.log_path.read_text()
    assert "Episode 1 (cup, teleoperation): held." in log and str(file) in log

    label = rospy.ServiceProxy("grasping/collection_label", SetBool)
    for keep, there in ((False, []), (False, []), (True, [file]), (True, [file])):
        answer = label(keep)
        assert answer.success, answer.message
        assert files(folder) == there

    rospy.set_param("grasp_collection/object", "box")
    rig.perform(grasp(touched=False))
    _, second = files(folder)
    made = decode(second.read_bytes())
    assert not made.held and made.metadata.object == "box"
    rospy.set_param("grasp_collection/object", 7)  # as `rosparam set` reads 007
    rig.perform(grasp(touched=False))
    third = files(folder)[-1]
    assert third != second and decode(third.read_bytes()).metadata.object == "box"
    assert "The object is still called box: " in process.log_path.read_text()
    process.send_signal(signal.SIGINT)
    assert process.wait(LATER_S) == 0
    assert "Traceback" not in process.log_path.read_text()


def test_a_confirmed_proposal_makes_an_episode_by_its_outcome(rig, start, status, folder):
    def state(name):
        rig.say("/grasping/state", DiagnosticStatus(values=[KeyValue("state", name)]))

    process = start()
    assert status()["message"] == "0 episodes, 0 held"
    assert status()["frames_kept"] == "1", "a frame of the tool at rest"
    state("approaching")
    clock.sleep(2 * IMAGE_EVERY * TICK_S + STATUS_S)
    assert status()["frames_kept"] == "2", "one of the approach, as the one before is dropped"
    rig.say("/grasping/outcome", GraspOutcome(reason="The operator gave it up."))
    clock.sleep(LATER_S)
    assert "no episode: The operator gave it up." in process.log_path.read_text()
    wrong = GraspOutcome(tool=stamped_pose(tool(GRASP_Z), "elsewhere", rospy.Time.now()))
    rig.say("/grasping/outcome", wrong)
    clock.sleep(LATER_S)
    assert "is invalid" in process.log_path.read_text()
    outcome = GraspOutcome(tool=stamped_pose(tool(GRASP_Z), "kuka/base_frame", rospy.Time.now()))
    outcome.header.stamp = rospy.Time.now()
    outcome.held, outcome.reason = True, "It was felt."
    outcome.proposal.own_approach, outcome.proposal.quality = True, 0.75
    rig.say("/grasping/outcome", outcome)
    clock.sleep(LATER_S)
    (file,) = files(folder)
    made = decode(file.read_bytes())
    assert made.held and made.metadata.source == EXECUTION and made.metadata.reason == "It was felt."
    assert made.t_grasp == outcome.header.stamp.to_sec() and made.lift == 0.75
    np.testing.assert_allclose(made.T_base_tool_closed, tool(GRASP_Z), atol=1e-9)


@pytest.fixture
def full_disk():
    """No file may grow beyond 20 kB, as on a disk that is nearly full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_while_the_disk_is_full_an_episode_waits_and_at_the_end_it_is_named(rig, start, status, folder, full_disk):
    process = start()
    rig.say("/leap_kuka/state", teleop(True))
    rig.perform(grasp())
    clock.sleep(STATUS_S)
    assert "An episode waits in memory" in status()["message"]
    assert "File too large" in status()["message"] and status()["waiting"] == "1"
    assert os.listdir(folder) == []
    frames = int(status()["frames_kept"])
    rig.perform([(1.0, OPEN, False, GRASP_Z, GRASP_Z + 0.1)])
    clock.sleep(STATUS_S)
    assert int(status()["frames_kept"]) > frames, "it continues"
    process.send_signal(signal.SIGINT)
    assert process.wait(LATER_S) == 0
    assert "Traceback" not in process.log_path.read_text()
    assert "could not be written until the end" in process.log_path.read_text()


def test_what_is_missing_is_said_and_comes_back(rig, start, status, folder):
    def says(sentence):
        clock.sleep(STATUS_S + 2 * IMAGE_EVERY * TICK_S)  # at 5 Hz, every second image is looked at
        assert sentence in status()["message"]

    rig.silent = {"/camera/depth/image", "/camera/depth/camera_info", "/reflex_takktile/hand_state"}
    start()
    topics = "/camera/depth/image, /reflex_takktile/hand_state, /camera/depth/camera_info"
    assert status()["message"] == f"nothing has come on {topics}"
    rig.silent = set()
    says("0 episodes, 0 held")
    assert int(status()["frames_kept"]) > 0
    rig.silent = {"/reflex_takktile/hand_state"}
    clock.sleep(SILENT_S)
    says("nothing has come on /reflex_takktile/hand_state for")
    rig.silent = set()
    rig.depth = rig.depth[:240].copy()
    rig.perform([(0.5, OPEN, False, GRASP_Z, GRASP_Z + 0.05)])
    says("640 x 240, but its camera_info says 640 x 480")
    assert not files(folder)


def test_frames_in_which_ggcnn_takes_the_robot_for_an_object_make_no_episode(rig, start, status, folder):
    process = start(frames__hand_radius=2.0, frames__hand_reach=1.0)
    assert int(status()["frames_on_hand"]) > 0
    rig.perform([(1.0, FIST, True, GRASP_Z, GRASP_Z), (1.5, FIST, True, GRASP_Z, GRASP_Z + 0.1)])
    assert "no frame was kept since the operator began" in process.log_path.read_text()
    assert status()["frames_kept"] == "0" and not files(folder)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"watch__open_angle": 2.0}, "~watch/open_angle is 2 and must not be above closed_angle"),
        ({"ggcnn__tool__approach": "sideways"}, "~ggcnn/tool/approach is 'sideways'"),
    ],
)
def test_a_wrong_parameter_is_refused(ros, parameters, change, sentence):
    rospy.set_param(rospy.get_name(), parameters(**change))
    with pytest.raises(RigError, match=re.escape(sentence)):
        read_setup()
