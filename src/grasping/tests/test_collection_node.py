"""The node grasp_collection: episodes from live topics and from a recording, and what is wrong with either."""

import os
import re
import signal
import sys
from pathlib import Path

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
    PuppetRig,
    camera_pose,
    grasp,
    messages,
    stream,
    ticks,
    tool,
)
from episodes import CAMERA, DOWN, episode

from common.errors import RigError
from grasping.lab.dataset.episode import EXECUTION, TELEOPERATION
from grasping.lab.dataset.labels import relative_label
from grasping.lab.dataset.store import decode, encode, file_name

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros


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
            "folder": str(folder), "object": "cup", "operator": "puppet", "from_bag": False, "tf_wait": 2.0,
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
def start(ros, processes, parameters):
    """Starts the node with the parameters."""
    import rospy

    def run(command=("rosrun", "grasping", "collect.py"), **changes):
        rospy.set_param("grasp_collection", parameters(**changes))
        rospy.set_param("kuka", yaml.safe_load(KUKA.read_text()))
        return processes.start(*command)

    return run


@pytest.fixture
def rig(ros):
    made = PuppetRig()
    yield made
    made.close()


@pytest.fixture
def status(ros):
    """A function that gives the message and the values of the node's last status."""
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        found = [s for array in arrays for s in array.status if s.name == "grasp_collection"]
        values = {v.key: v.value for v in found[-1].values} if found else {}
        return {"level": found[-1].level, "message": found[-1].message, **values} if found else {"message": ""}

    return read


def files(folder):
    return sorted(folder.glob("*.npz"))


def test_a_person_who_grasps_makes_an_episode_and_may_take_it_back(rig, start, status, folder, processes, wait_until):
    import rospy
    from std_srvs.srv import SetBool

    process = start()
    wait_until(lambda: status()["message"] == "0 episodes, 0 held", 60.0, "that it listens")
    rig.say("/leap_kuka/stream", stream(True))
    rig.perform(grasp())
    (file,) = wait_until(lambda: files(folder), 20.0, "the episode")
    made = decode(file.read_bytes())
    assert made.held and made.metadata.source == TELEOPERATION
    assert (made.metadata.object, made.metadata.operator) == ("cup", "puppet")
    assert made.metadata.configuration["kuka"]["robot"] == "LBR7R800"
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
    wait_until(lambda: status()["message"] == "1 episodes, 1 held", 15.0, "the status")
    log = process.log_path.read_text()
    assert "Episode 1 (cup, teleoperation): held." in log and str(file) in log

    label = rospy.ServiceProxy("grasping/collection_label", SetBool)
    for keep, there in ((False, []), (False, []), (True, [file]), (True, [file])):
        answer = label(keep)
        assert answer.success, answer.message
        assert files(folder) == there

    rospy.set_param("grasp_collection/object", "box")
    rig.perform(grasp(touched=False))
    wait_until(lambda: len(files(folder)) == 2, 20.0, "the second episode")
    made = decode(files(folder)[-1].read_bytes())
    assert not made.held and made.metadata.object == "box"
    assert processes.end(process) == 0
    assert "Traceback" not in process.log_path.read_text()


def test_a_confirmed_proposal_makes_an_episode_by_its_outcome(rig, start, status, folder, wait_until):
    import rospy
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    from common.ros.conversions import stamped_pose
    from grasp_msgs.msg import GraspOutcome

    def state(name):
        rig.say("/grasping/state", DiagnosticStatus(values=[KeyValue("state", name)]))

    process = start()
    wait_until(lambda: status()["message"] == "0 episodes, 0 held", 60.0, "that it listens")
    wait_until(lambda: status()["frames_kept"] == "1", 15.0, "a frame of the tool at rest")
    state("approaching")
    wait_until(lambda: status()["frames_kept"] == "2", 15.0, "one of the approach, as the one before is dropped")
    rig.say("/grasping/outcome", GraspOutcome(reason="The operator gave it up."))
    wait_until(lambda: "no episode: The operator gave it up." in process.log_path.read_text(), 15.0, "the sentence")
    wrong = GraspOutcome(tool=stamped_pose(tool(GRASP_Z), "elsewhere", rospy.Time.now()))
    rig.say("/grasping/outcome", wrong)
    wait_until(lambda: "is invalid" in process.log_path.read_text(), 15.0, "the sentence")
    outcome = GraspOutcome(tool=stamped_pose(tool(GRASP_Z), "kuka/base_frame", rospy.Time.now()))
    outcome.header.stamp = rospy.Time.now()
    outcome.held, outcome.reason = True, "It was felt."
    rig.say("/grasping/outcome", outcome)
    (file,) = wait_until(lambda: files(folder), 20.0, "the episode")
    made = decode(file.read_bytes())
    assert made.held and made.metadata.source == EXECUTION and made.metadata.reason == "It was felt."
    assert made.t_grasp == outcome.header.stamp.to_sec()
    np.testing.assert_allclose(made.T_base_tool_closed, tool(GRASP_Z), atol=1e-9)


def write_bag(path: Path, began: float) -> None:
    """Records two grasps."""
    import rosbag
    import rospy

    with rosbag.Bag(str(path), "w") as bag:
        now = rospy.Time.from_sec(began)
        bag.write("/tf_static", camera_pose(now), now)
        bag.write("/leap_kuka/stream", stream(True), now)
        for i, tick in enumerate(ticks([*grasp(), *grasp(touched=False)])):
            now = rospy.Time.from_sec(began + 0.05 * (i + 1))
            for topic, message in messages(now, *tick):
                if i % IMAGE_EVERY == 0 or not topic.startswith("/camera"):
                    bag.write(topic, message, now)


def test_a_recording_makes_the_same_episodes_and_makes_them_once(ros, processes, folder, wait_until, tmp_path):
    write_bag(tmp_path / "operator.bag", 1.6e9)
    arguments = {"bag": str(tmp_path / "operator.bag"), "folder": str(folder), "object": "cup", "operator": "puppet"}
    process = ros.launch("grasping", "collect.launch", **arguments)
    assert process.wait(180.0) == 0
    log = process.log_path.read_text()
    made = [decode(file.read_bytes()) for file in files(folder)]
    assert [m.held for m in made] == [True, False], log
    assert made[0].metadata.date == "2020-09-13T12:26:42Z"
    np.testing.assert_allclose(made[0].T_base_tool_closed, tool(GRASP_Z), atol=1e-6)
    assert len(made[0]) >= 2 and np.all(np.diff(made[0].stamp) > 0.0)
    # Again with the parameters that are still there, but forked: it need not import its libraries once more.
    again = ros.run("grasping", "collect.py", "__name:=grasp_collection")
    processes.start("rosbag", "play", "--quiet", "--clock", "--pause", arguments["bag"], "__name:=collection_bag")
    wait_until(lambda: again.log_path.read_text().count("holds that grasp already") == 2, 60.0, "both grasps")
    assert len(files(folder)) == 2


def test_while_the_disk_is_full_an_episode_waits_and_at_the_end_it_is_named(
    rig, start, status, folder, processes, wait_until
):
    """No file may grow beyond 20 kB, as on a disk that is nearly full."""
    script = str(CONFIG.parent / "scripts" / "collect.py")
    process = start(command=("bash", "-c", f"ulimit -f 20; exec {sys.executable} {script}"))
    wait_until(lambda: status()["message"] == "0 episodes, 0 held", 60.0, "that it listens")
    rig.say("/leap_kuka/stream", stream(True))
    rig.perform(grasp())
    wait_until(lambda: "An episode waits in memory" in status()["message"], 20.0, "that it says so")
    assert "File too large" in status()["message"] and status()["waiting"] == "1"
    assert os.listdir(folder) == []
    frames = int(status()["frames_kept"])
    rig.perform([(1.0, OPEN, False, GRASP_Z, GRASP_Z + 0.1)])
    wait_until(lambda: int(status()["frames_kept"]) > frames, 15.0, "that it continues")
    assert processes.end(process) == 0
    assert "Traceback" not in process.log_path.read_text()
    assert "could not be written until the end" in process.log_path.read_text()


def test_a_process_that_dies_while_it_writes_leaves_no_episode_but_a_sentence(start, folder, processes, wait_until):
    one = episode()
    whole = folder / file_name(one)
    folder.mkdir()
    whole.write_bytes(encode(one))
    died = folder / whole.name.replace("episode_1970", "episode_1971")
    code = (
        "import os, signal, sys; from pathlib import Path; from common.ros.files import write_whole;"
        "os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL);"
        "write_whole(Path(sys.argv[1]), b'half of an episode')"
    )
    assert processes.start(sys.executable, "-c", code, str(died)).wait(60.0) == -signal.SIGKILL
    assert files(folder) == [whole] and len(os.listdir(folder)) == 2
    process = start()
    wait_until(lambda: "is lost: the process that wrote it died" in process.log_path.read_text(), 60.0, "the sentence")
    assert decode(whole.read_bytes()).held


def test_killed_before_the_next_grasp_it_loses_no_grasp(rig, start, status, folder, wait_until):
    process = start()
    wait_until(lambda: status()["message"] == "0 episodes, 0 held", 60.0, "that it listens")
    rig.say("/leap_kuka/stream", stream(True))
    rig.perform(grasp())
    (first,) = wait_until(lambda: files(folder), 20.0, "the episode")
    content = first.read_bytes()
    wait_until(lambda: int(status()["frames_waiting"]) > 0, 15.0, "a frame that waits for the next grasp")
    process.kill()
    process.wait()
    assert os.listdir(folder) == [first.name]
    start()
    wait_until(lambda: status()["message"] == "0 episodes, 0 held", 60.0, "that it listens again")
    rig.perform(grasp())
    wait_until(lambda: len(files(folder)) == 2, 20.0, "the next episode")
    assert first.read_bytes() == content
    assert all(decode(file.read_bytes()).held for file in files(folder))


def test_what_is_missing_is_said_and_comes_back(rig, start, status, folder, wait_until):
    rig.silent = {"/camera/depth/image", "/camera/depth/camera_info", "/reflex_takktile/hand_state"}
    start()
    wait_until(lambda: status()["message"] == "waits for depth images and the state of the hand", 60.0, "the status")
    rig.silent = {"/camera/depth/camera_info"}
    wait_until(lambda: "nobody publishes /camera/depth/camera_info" in status()["message"], 15.0, "the status")
    rig.silent = set()
    wait_until(lambda: int(status()["frames_kept"]) > 0, 15.0, "frames")
    rig.depth = rig.depth[:240].copy()
    rig.perform([(0.5, OPEN, False, GRASP_Z, GRASP_Z + 0.05)])
    wait_until(lambda: "640 x 240 is not of the described camera" in status()["message"], 15.0, "the status")
    rig.depth = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
    rig.perform([(0.5, OPEN, False, GRASP_Z, GRASP_Z + 0.05)])
    wait_until(lambda: "holds no reading" in status()["message"], 15.0, "the status")
    assert not files(folder)


def test_frames_in_which_ggcnn_takes_the_robot_for_an_object_make_no_episode(rig, start, status, folder, wait_until):
    process = start(frames__hand_radius=2.0, frames__hand_reach=1.0)
    wait_until(lambda: int(status().get("frames_on_hand", 0)) > 0, 60.0, "frames that are left out")

    def reported():
        rig.perform([(1.0, FIST, True, GRASP_Z, GRASP_Z), (1.5, FIST, True, GRASP_Z, GRASP_Z + 0.1)])
        rig.perform([(0.5, OPEN, False, GRASP_Z + 0.1, GRASP_Z)])
        return "no frame was kept since the operator began" in process.log_path.read_text()

    wait_until(reported, 15.0, "the sentence")
    assert status()["frames_kept"] == "0" and not files(folder)


FAULTS = [
    ({"crop": 300}, "~crop is not a known key"),
    ({"ggcnn__network__weights": "/nowhere/ggcnn.pt"}, "/nowhere/ggcnn.pt cannot be read: No such file or directory"),
]


@pytest.mark.parametrize(("change", "sentence"), FAULTS)
def test_it_ends_with_a_sentence(start, change, sentence):
    process = start(**change)
    assert process.wait(120.0) == 1
    log = process.log_path.read_text()
    assert sentence in log
    assert "Traceback" not in log


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"frames__rate": 0.0}, "~frames/rate is 0.0"),
        ({"watch__open_angle": 2.0}, "~watch/open_angle is 2 and must not be above closed_angle"),
        ({"ggcnn__tool__approach": "sideways"}, "~ggcnn/tool/approach is 'sideways'"),
        ({"object": ""}, "~object is ''"),
        ({"folder": "grasps"}, "~folder is 'grasps'"),
        (
            {"ggcnn__network__weights": str(CONFIG / "collection.yaml"), "ggcnn__network__sha256": "any"},
            "neither a torch file nor",
        ),
    ],
)
def test_a_wrong_parameter_is_refused(ros, parameters, change, sentence):
    """In this process: a node of its own takes many seconds to import all that it needs."""
    import rospy

    from grasping.lab.ros.collection_setup import read_setup

    rospy.set_param(rospy.get_name(), parameters(**change))
    with pytest.raises(RigError, match=re.escape(sentence)):
        read_setup()


def test_a_recording_without_the_topics_ends_with_a_sentence(start):
    process = start(from_bag=True)
    assert process.wait(180.0) == 1
    assert "depth images" in process.log_path.read_text()


def test_an_interrupt_ends_it(start, status, processes, wait_until):
    process = start()
    wait_until(lambda: "waits for" in status()["message"], 60.0, "the status")
    assert processes.end(process) == 0
    assert "Traceback" not in process.log_path.read_text()
