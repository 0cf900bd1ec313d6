"""The camera's node before a small world: topics, load, loss and return of the world, faults, bad parameters."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("mujoco.egl")
pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

from common import clock
from common.errors import RigError
from common.ros.images import array_from_image
from rig_simulation.control_port import ControlClient, ControlPort
from rig_simulation.files import read_scene
from rig_simulation.ros.camera import main
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.physics import World

pytestmark = pytest.mark.ros

RATE, PORT, CONTROL_PORT = 15.0, 30021, 30031
CONFIG = Path(__file__).parents[1] / "config" / "camera.yaml"
CALIBRATION = {
    "image_width": 160,
    "image_height": 120,
    "camera_name": "small",
    "camera_matrix": {"data": [140.0, 0.0, 79.5, 0.0, 140.0, 59.5, 0.0, 0.0, 1.0]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"data": [0.0] * 5},
    "rectification_matrix": {"data": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
    "projection_matrix": {"data": [140.0, 0.0, 79.5, 0.0, 0.0, 140.0, 59.5, 0.0, 0.0, 0.0, 1.0, 0.0]},
}


class SmallWorld:
    """The control port of a world in which nothing moves by itself."""

    def __init__(self, scene: str = "cup") -> None:
        self.world = World(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), read_scene(scene)))
        self.snapshots = 0

    def open(self) -> ControlPort:
        return ControlPort({"scene": self._scene, "snapshot": self._snapshot}, port=PORT)

    def _scene(self) -> dict:
        return {"loads": self.world.loads, **dataclasses.asdict(self.world.description)}

    def _snapshot(self) -> dict:
        self.snapshots += 1
        return {"time": 0.0, "loads": self.world.loads, "qpos": self.world.data.qpos.tolist()}


def parameters(**changes) -> dict:
    """Returns the parameters of the package with a small image, and with changes."""
    values = {**yaml.safe_load(CONFIG.read_text()), "samples": 0}
    values.update(rgb_calibration=CALIBRATION, depth_calibration=CALIBRATION)
    for name, value in changes.items():
        values[name] = {**values[name], **value} if isinstance(value, dict) else value
    return values


@pytest.fixture(scope="module")
def small_world():
    return SmallWorld()


@pytest.fixture
def world(small_world):
    """The world of all tests of this module, in its first scene."""
    if small_world.world.loads > 1:
        small_world.world.set_scene(read_scene("cup"))
    return small_world


@pytest.fixture
def start(ros):
    """Starts the node `driver` with the package's parameters and changes to them; returns it."""

    def start_node(**changes):
        rospy.set_param("camera/driver", parameters(**changes))
        return ros.run("rig_simulation", "camera_node.py", "__ns:=camera", "__name:=driver")

    return start_node


def switch(name: str, on: bool = True) -> None:
    """Switches a fault at the camera's control port."""
    with ControlClient("127.0.0.1", CONTROL_PORT) as control:
        control.ask("fault", name=name, on=on)


def diagnostics(ros):
    """Returns a function that gives the node's last status: its level, message and values."""
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        last = arrays[-1].status[0]
        return {"level": last.level, "message": last.message, **{v.key: v.value for v in last.values}}

    return read


def test_it_publishes_what_an_xtion_does(world, start, ros):
    images = {
        topic: ros.record(f"camera/{topic}", Image)
        for topic in ("rgb/image_raw", "depth/image_raw", "depth/image", "depth_registered/image_raw")
    }
    infos = {
        name: ros.record(f"camera/{name}/camera_info", CameraInfo) for name in ("rgb", "depth", "depth_registered")
    }
    announced = ros.record("/simulated_devices", String)
    with world.open():
        start()
        clock.sleep(1.0)
    assert [message.data for message in announced] == ["/camera/driver"]
    together = [[m.header.stamp for m in recording] for recording in (*images.values(), *infos.values())]
    assert all(stamps == together[0] for stamps in together), "all images of one moment have one stamp"
    assert len(together[0]) == pytest.approx(RATE, abs=1)
    facts = {topic: (p[-1].encoding, p[-1].header.frame_id, p[-1].width, p[-1].height) for topic, p in images.items()}
    rgb, depth = "camera_rgb_optical_frame", "camera_depth_optical_frame"
    assert facts == {
        "rgb/image_raw": ("rgb8", rgb, 160, 120),
        "depth/image_raw": ("16UC1", depth, 160, 120),
        "depth/image": ("32FC1", depth, 160, 120),
        "depth_registered/image_raw": ("16UC1", rgb, 160, 120),
    }
    assert [infos[name][-1].header.frame_id for name in ("rgb", "depth", "depth_registered")] == [rgb, depth, rgb]
    np.testing.assert_array_equal(infos["depth"][-1].K, CALIBRATION["camera_matrix"]["data"])
    raw = np.frombuffer(images["depth/image_raw"][-1].data, "<u2")
    metres = np.frombuffer(images["depth/image"][-1].data, "<f4")
    np.testing.assert_allclose(np.nan_to_num(metres) * 1000.0, raw, atol=1e-3)
    assert np.mean(raw > 0) > 0.5


def test_without_listeners_nothing_is_rendered_and_the_world_is_looked_at_once_a_second(world, start, ros):
    infos, status = ros.record("camera/rgb/camera_info", CameraInfo), diagnostics(ros)
    with world.open():
        start()
        clock.sleep(0.55)
        before, published = world.snapshots, len(infos)
        clock.sleep(3.0)
        assert world.snapshots == before + 3 and len(infos) - published == pytest.approx(3.0 * RATE, abs=1)
        assert not any(key.startswith("render") for key in status())
        ros.record("camera/rgb/image_raw", Image)
        before = world.snapshots
        clock.sleep(1.0)
        assert world.snapshots - before == pytest.approx(RATE, abs=1)
        assert "render_rgb_ms" in status() and "render_depth_ms" not in status()


def test_it_waits_for_the_world_and_continues_when_it_comes_back(world, start, ros):
    status = diagnostics(ros)
    process = start()
    images = ros.record("camera/rgb/image_raw", Image)
    clock.sleep(1.1)
    assert status()["level"] == 2 and str(PORT) in status()["message"] and not images
    with world.open():
        clock.sleep(0.6)
        assert images, "it asks again every 0.5 s"
        clock.sleep(0.5)
        assert status()["level"] == 0
    clock.sleep(0.6)
    assert status()["level"] == 2
    before = len(images)
    assert process.poll() is None
    with SmallWorld("objects").open():
        clock.sleep(0.6)
        assert len(images) > before


def test_a_change_of_scene_is_seen(world, start, ros):
    images = ros.record("camera/rgb/image_raw", Image)
    with world.open():
        start(colour={"noise": 0.0})
        clock.sleep(0.3)
        before = images[-1].data
        assert images[-2].data == before
        world.world.set_scene(read_scene("objects"))
        clock.sleep(0.15)
        assert images[-1].data != before


def is_whole(message) -> bool:
    try:
        return array_from_image(message).shape[:2] == (120, 160)
    except ValueError:
        return False


def test_faults_are_switched_at_its_control_port_and_a_driver_that_restarts_takes_its_topics_back(world, start, ros):
    topics = ("rgb/image_raw", "depth/image_raw", "depth/image")
    rgb, depth, _ = images = [ros.record(f"camera/{topic}", Image) for topic in topics]
    status = diagnostics(ros)
    with world.open():
        start(fault="garbled")
        clock.sleep(0.8)
        for recording in images:
            assert len(recording) >= 8 and not any(map(is_whole, recording))
        switch("garbled", False)
        switch("depth_empty")
        clock.sleep(0.6)
        assert all(is_whole(recording[-1]) for recording in images)
        assert not np.frombuffer(depth[-1].data, "<u2").any()
        assert status()["level"] == 1 and status()["faults"] == "depth_empty"
        switch("depth_empty", False)
        clock.sleep(0.15)
        assert np.frombuffer(depth[-1].data, "<u2").any()
        switch("restarted")
        clock.sleep(0.15)
        before = len(rgb)
        assert not {topic for topic in ros.names("/camera/driver")["publishes"] if topic.startswith("/camera")}
        clock.sleep(0.5)
        assert len(rgb) == before
        switch("restarted", False)
        clock.sleep(0.3)
        assert len(rgb) >= before + 2 and "/camera/depth/camera_info" in ros.names("/camera/driver")["publishes"]


@pytest.mark.parametrize(
    "changes, key",
    [
        ({"fault": "stuck dance:3"}, "~fault"),
        ({"depth": {"quantum": 1.0}}, "~depth/quantum"),
        ({"rgb_calibration": {"distortion_model": "fisheye"}}, "distortion_model"),
    ],
)
def test_bad_parameters_are_refused(ros, changes, key):
    rospy.set_param("~", parameters(**changes))
    with pytest.raises(RigError, match=key):
        main()
