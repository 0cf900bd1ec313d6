"""The camera's nodes: driver of the XtionNode before a stand-in of its library, watchdog, frames, launch file."""

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image

from common.config import parse
from common.ros.images import image_message
from vision.camera.stream_watch import WatchConfig
from vision.ros.camera.watchdog_node import WatchedStream

pytestmark = pytest.mark.ros

FAKES = Path(__file__).parent / "fake_openni"
CONFIG = Path(__file__).parents[1] / "config"
SIZE = {"image_width": 32, "image_height": 24}


@pytest.fixture
def xtion(ros, monkeypatch, tmp_path):
    """Starts the driver before the stand-in of its library; returns the node and the file that rules the camera."""
    for name in ("openni", "openni.openni2"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(FAKES))

    def start(does: str, **changes):
        state = tmp_path / "camera"
        state.write_text(does)
        monkeypatch.setenv("FAKE_CAMERA", str(state))
        values = yaml.safe_load((CONFIG / "xtion.yaml").read_text())
        for name in ("rgb", "depth"):
            calibration = yaml.safe_load((CONFIG / f"xtion_{name}.yaml").read_text())
            for key, columns in (("camera_matrix", 3), ("projection_matrix", 4)):
                matrix = np.reshape(calibration[key]["data"], (3, columns))
                matrix[:2] *= SIZE["image_width"] / calibration["image_width"]
                calibration[key]["data"] = matrix.ravel().tolist()
            said = {"simulated": True, "maybe": "maybe"}.get(does, False)
            values[f"{name}_calibration"] = {**calibration, **SIZE, "simulated": said}
        values["frames"] = yaml.safe_load((CONFIG / "camera_frames.yaml").read_text())
        rospy.set_param("camera/driver", {**values, **changes})
        return ros.run("vision", "xtion_node.py", "__ns:=camera", "__name:=driver"), state

    yield start
    for name in ("openni", "openni.openni2"):
        sys.modules.pop(name, None)


def statuses(ros, name: str):
    """Returns a function that gives the level, the message and the values of a node's last status."""
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        found = [s for array in arrays for s in array.status if s.name == name]
        if not found:
            return {}
        values = {v.key: v.value for v in found[-1].values}
        return {"level": found[-1].level, "message": found[-1].message, **values}

    return read


def test_the_xtions_images_have_the_drivers_names(xtion, ros):
    topics = ("rgb/image_raw", "depth/image_raw", "depth/image")
    images = {topic: ros.record(f"camera/{topic}", Image) for topic in topics}
    info = ros.record("camera/depth/camera_info", CameraInfo)
    xtion("present")
    clock.sleep(0.1)
    facts = [(p[-1].encoding, p[-1].header.frame_id, p[-1].width) for p in images.values()]
    rgb, depth = "camera_rgb_optical_frame", "camera_depth_optical_frame"
    assert facts == [("rgb8", rgb, 32), ("16UC1", depth, 32), ("32FC1", depth, 32)]
    assert np.frombuffer(images["depth/image"][-1].data, "<f4")[0] == pytest.approx(1.0, abs=0.1)
    stamps = [{m.header.stamp for m in recording} for recording in (images["depth/image_raw"], info)]
    assert len(stamps[0]) >= 3 and stamps[0] <= stamps[1], "each image has its info"
    assert rospy.get_param("camera/driver/serial") == "1207290099"


@pytest.mark.parametrize("by_the_device", [False, True])
def test_registered_depth_has_its_own_topic(xtion, ros, by_the_device):
    registered = ros.record("camera/depth_registered/image_raw", Image)
    xtion("present", depth_registration=by_the_device)
    message = registered.wait(1, 0.1)[-1]
    assert (message.encoding, message.header.frame_id) == ("16UC1", "camera_rgb_optical_frame")


def test_a_camera_pulled_out_or_silent_is_reported_and_comes_back(xtion, ros):
    status = statuses(ros, "camera")
    images = ros.record("camera/rgb/image_raw", Image)
    process, state = xtion("present")
    clock.sleep(1.0)
    state.write_text("absent")
    clock.sleep(0.6)
    assert (status()["level"], status()["losses"]) == (2, "1") and process.poll() is None
    state.write_text("present")
    before = len(images)
    clock.sleep(1.3)
    assert len(images) == before, "it tries again every 2 s"
    clock.sleep(0.7)
    assert len(images) > before
    assert (status()["level"], status()["losses"]) == (0, "1")
    state.write_text("silent")
    clock.sleep(2.0)
    assert status()["level"] == 1 and "Nothing has come on the camera's colour stream" in status()["message"]
    assert "reopened" not in process.log_path.read_text()
    clock.sleep(1.1)
    log = process.log_path.read_text()
    assert log.count("; the camera is reopened.") == 1 and "Nothing has come on the camera's colour stream" in log
    assert status()["losses"] == "2"


@pytest.mark.parametrize(
    "does, changes, complaint",
    [
        ("absent", {}, "no devices found"),
        ("present", {"rate": 0, "gain": 1}, "~gain is not a known key"),
        ("present", {"rgb_calibration": {}}, "camera_matrix"),
        ("simulated", {}, "The calibration rgb_calibration was measured with simulated devices"),
        ("present", {"frames": {}}, "~frames/rgb"),
    ],
)
def test_without_a_camera_it_exits_with_a_sentence(xtion, does, changes, complaint):
    process, _ = xtion(does, **changes)
    assert process.wait(1.0) == 1
    output = process.log_path.read_text()
    assert complaint in output
    assert ("sim:=true" in output) is (does == "absent")
    assert "Traceback" not in output


class Source:
    """Publishes the topics of a camera, new ones or always the same."""

    def __init__(self) -> None:
        self._infos = [rospy.Publisher(f"watched/{n}/camera_info", CameraInfo, queue_size=1) for n in ("rgb", "depth")]
        self._images = [rospy.Publisher(f"watched/{n}/image_raw", Image, queue_size=1) for n in ("rgb", "depth")]
        self.sends = self.new_stamps = self.new_images = True
        self.depth = 1000
        self.rows = 2
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def takers(self) -> int:
        return self._images[0].get_num_connections()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        for publisher in (*self._infos, *self._images):
            publisher.unregister()

    def _loop(self) -> None:
        number, stamp = 0, rospy.Time.now()
        while not self._stop.wait(0.05):
            if not self.sends:
                continue
            number += self.new_images
            stamp = rospy.Time.now() if self.new_stamps else stamp
            colour = np.full((2, 2, 3), number % 256, np.uint8)
            depth = np.full((3, 2), self.depth and self.depth + number % 100, np.uint16)
            info = CameraInfo(height=2, width=2)
            info.header.stamp = stamp
            self._images[0].publish(image_message(colour, "rgb8", "f", stamp))
            torn = image_message(depth[: self.rows], "16UC1", "f", stamp)
            torn.step += self.rows > 2  # a row longer than its bytes
            self._images[1].publish(torn)
            for publisher in self._infos:
                publisher.publish(info)
            self.last = clock.monotonic()


@pytest.fixture
def source(ros):
    made = Source()
    yield made
    made.close()


def start_watchdog(ros, **changes):
    values = yaml.safe_load((CONFIG / "camera_watchdog.yaml").read_text())
    rospy.set_param("watched/watchdog", {**values, **changes})
    return ros.run("vision", "camera_watchdog_node.py", "__ns:=watched", "__name:=watchdog")


def test_the_watchdog_says_frozen_vanished_garbled_empty_and_well_again(ros, source):
    for name in ("rgb", "depth"):
        ros.record(f"watched/{name}/image_raw", Image)
    status = statuses(ros, "camera_watchdog")
    process = start_watchdog(ros)

    def states() -> tuple:
        return status().get("rgb"), status().get("depth")

    def becomes(after: float, rgb: str, depth: str) -> None:
        before = states()
        clock.sleep(after - 0.06)
        assert states() == before
        clock.sleep(0.23)
        assert states() == (rgb, depth)

    def recovers() -> None:
        clock.sleep(0.17)
        assert set(states()) <= {"alive", "slow"}, "the rate is that of 2 s"
        clock.sleep(2.0)
        assert states() == ("alive", "alive")

    clock.sleep(1.2)
    assert states() == ("alive", "alive")
    source.sends = False
    becomes(0.8, "vanished", "vanished")
    assert status()["level"] == 2 and "vanished" in status()["message"]
    source.sends = True
    recovers()
    source.new_stamps = False
    becomes(0.8, "frozen", "frozen")
    source.new_stamps = True
    recovers()
    for rows, complaint in ((1, "an image of 2 x 1"), (3, "12 bytes instead of 5 x 3")):
        source.rows = rows
        clock.sleep(0.6)
        assert states() == ("alive", "garbled") and complaint in status()["message"]
    assert int(status()["depth_garbled"]) > 0 and status()["rgb_garbled"] == "0"
    source.rows = 2
    becomes(0.8, "alive", "alive")
    source.depth = 0
    becomes(0.06, "alive", "empty")
    log = process.log_path.read_text()
    for sentence in ("The colour camera vanished", "The depth camera is frozen", "The depth camera measures nothing"):
        assert sentence in log


def test_the_watchdog_looks_ten_times_a_second(ros, source):
    """A stream has vanished 0.8 s after its last image."""
    status = statuses(ros, "camera_watchdog")
    start_watchdog(ros)
    clock.sleep(0.5)
    times = []
    for _ in range(10):
        source.sends = False
        clock.sleep(0.05)
        ros.wait_until(lambda: status()["rgb"] == "vanished", 1.0, "the report", poll=0.001)
        times.append(clock.monotonic() - source.last)
        source.sends = True
        clock.sleep(0.5 + ros.scheduler.drawn(0.2))
    assert min(times) >= 0.8 and max(times) <= 0.91, times


def test_the_watchdog_takes_images_only_while_others_do_and_sees_that_they_stay_the_same(ros, source):
    """It looks for others once a second."""
    status = statuses(ros, "camera_watchdog")
    start_watchdog(ros)
    source.new_images = False
    clock.sleep(3.0)
    for _ in range(3):
        assert source.takers() == 0 and status()["rgb"] == "alive"
        listeners = [rospy.Subscriber(f"watched/{name}/image_raw", Image) for name in ("rgb", "depth")]
        ros.wait_until(lambda: source.takers() == 2, 1.13, "the watchdog")
        clock.sleep(0.7)
        assert status()["rgb"] == "alive"
        clock.sleep(0.32)
        assert (status()["rgb"], status()["depth"]) == ("frozen", "frozen")
        clock.sleep(ros.scheduler.drawn(1.0))
        for listener in listeners:
            listener.unregister()
        clock.sleep(1.23)


def test_an_image_that_comes_after_the_last_listener_is_gone_does_not_count(ros):
    """Else a camera whose images nobody takes any more would freeze with the next two."""
    values = yaml.safe_load((CONFIG / "camera_watchdog.yaml").read_text())
    stream = WatchedStream("rgb", parse(WatchConfig, values, ""))
    late = stream._on_image
    stream.subscribe(True)
    stream.subscribe(False)
    for _ in range(20):
        message = CameraInfo(height=2, width=2)
        message.header.stamp = rospy.Time.now()
        stream._on_info(message)
        late(image_message(np.zeros((2, 2, 3), np.uint8), "rgb8", "f", message.header.stamp))
        clock.sleep(0.1)
    assert stream.report()[0].state == "alive"


def test_the_watchdog_refuses_bad_limits(ros):
    process = start_watchdog(ros, silence=0.0)
    assert process.wait(1.0) == 1
    assert "~silence is 0.0" in process.log_path.read_text()


def test_the_launch_file_brings_frames_and_waits_for_the_world(ros):
    driver, watchdog = statuses(ros, "camera"), statuses(ros, "camera_watchdog")
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    process = ros.launch("vision", "camera.launch", sim="true", port=30099, control_port=0)
    clock.sleep(1.0)
    found = buffer.lookup_transform("camera_rgb_optical_frame", "camera_depth_optical_frame", rospy.Time())
    assert found.transform.translation.x == pytest.approx(-0.027)
    assert driver()["level"] == 2 and "127.0.0.1:30099" in driver()["message"]
    assert watchdog()["rgb"] == "waiting"
    assert all(node.poll() is None for node in process.nodes)
