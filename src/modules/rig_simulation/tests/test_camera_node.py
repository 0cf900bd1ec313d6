"""The camera's node before a small world: topics, load, loss and return of the world, faults, bad parameters."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from common.errors import RigError
from rig_simulation.control_port import ControlClient, ControlPort

pytest.importorskip("rospy")
pytest.importorskip("mujoco.egl")
pytestmark = pytest.mark.ros

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
        from rig_simulation.files import read_scene
        from rig_simulation.world.model import WorldDescription
        from rig_simulation.world.physics import World

        self.world = World(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), read_scene(scene)))
        self.snapshots = 0

    def open(self, port: int = 0) -> ControlPort:
        return ControlPort({"scene": self._scene, "snapshot": self._snapshot}, port=port)

    def _scene(self) -> dict:
        return {"loads": self.world.loads, **dataclasses.asdict(self.world.description)}

    def _snapshot(self) -> dict:
        self.snapshots += 1
        return {"time": 0.0, "loads": self.world.loads, "qpos": self.world.data.qpos.tolist()}


def parameters(port: int, **changes) -> dict:
    """Returns the parameters of the package with a small image, for a world at `port`, and with changes."""
    values = {**yaml.safe_load(CONFIG.read_text()), "port": port, "samples": 0}
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
    from rig_simulation.files import read_scene

    if small_world.world.loads > 1:
        small_world.world.set_scene(read_scene("cup"))
    return small_world


@pytest.fixture
def start(ros, free_port):
    """Starts the node `driver` with the package's parameters and changes to them; returns its process."""
    import rospy

    def start_node(port: int, namespace: str = "camera", **changes):
        values = parameters(port, **{"control_port": free_port(), **changes})
        rospy.set_param(f"{namespace}/driver", values)
        start_node.control = ControlClient("127.0.0.1", values["control_port"], 30.0)
        return ros.run("rig_simulation", "camera_node.py", f"__ns:={namespace}", "__name:=driver")

    return start_node


def test_it_publishes_what_an_xtion_does(world, start, ros, wait_until):
    from sensor_msgs.msg import CameraInfo, Image

    images = {
        topic: ros.record(f"camera/{topic}", Image)
        for topic in ("rgb/image_raw", "depth/image_raw", "depth/image", "depth_registered/image_raw")
    }
    infos = {
        name: ros.record(f"camera/{name}/camera_info", CameraInfo) for name in ("rgb", "depth", "depth_registered")
    }
    with world.open() as port:
        start(port.port)
        for recording in (*images.values(), *infos.values()):
            recording.wait(3)
        together = (*images.values(), infos["rgb"])
        wait_until(lambda: set.intersection(*({m.header.stamp for m in r} for r in together)), 15.0, "one moment")
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
    raw = {m.header.stamp: np.frombuffer(m.data, "<u2") for m in images["depth/image_raw"]}
    stamp, metres = next(
        (m.header.stamp, np.frombuffer(m.data, "<f4")) for m in images["depth/image"] if m.header.stamp in raw
    )
    np.testing.assert_allclose(np.nan_to_num(metres) * 1000.0, raw[stamp], atol=1e-3)
    assert np.mean(raw[stamp] > 0) > 0.5


def test_without_listeners_nothing_is_rendered(world, start, ros, wait_until):
    from sensor_msgs.msg import CameraInfo, Image

    # The subscribers of the other tests stay; nobody listens in this namespace.
    infos = ros.record("unheard/rgb/camera_info", CameraInfo)
    status = diagnostics(ros)
    with world.open() as port:
        start(port.port, "unheard")
        infos.wait(5)
        before, began = world.snapshots, time.monotonic()
        wait_until(lambda: status() and int(status()["pictures"]) > 30, 15.0, "images to be counted")
        assert not any(key.startswith("render") for key in status())
        assert world.snapshots - before < 10 + (time.monotonic() - began), "it looks at the world once a second"
        ros.record("unheard/rgb/image_raw", Image).wait(1)
        wait_until(lambda: "render_rgb_ms" in status(), 15.0, "the time of rendering")
        assert "render_depth_ms" not in status()


def test_it_waits_for_the_world_and_continues_when_it_comes_back(world, start, ros, free_port, wait_until):
    from sensor_msgs.msg import Image

    status = diagnostics(ros)
    port = free_port()
    process = start(port)
    wait_until(lambda: status().get("level") == 2, 15.0, "the report that there is no world")
    assert str(port) in status()["message"]
    images = ros.record("camera/rgb/image_raw", Image)
    with world.open(port):
        images.wait(2)
        wait_until(lambda: status().get("level") == 0, 15.0, "the report that all is well")
    wait_until(lambda: status().get("level") == 2, 15.0, "the report that the world is gone")
    before = len(images)
    assert process.poll() is None
    with SmallWorld("objects").open(port):
        images.wait(before + 2)


def test_a_change_of_scene_is_seen(world, start, ros, wait_until):
    from sensor_msgs.msg import Image

    from rig_simulation.files import read_scene

    images = ros.record("camera/rgb/image_raw", Image)
    with world.open() as port:
        start(port.port, colour={"noise": 0.0})
        images.wait(2)
        before = images[-1].data
        world.world.set_scene(read_scene("objects"))
        wait_until(lambda: images[-1].data != before, 15.0, "another image")


def test_faults_are_switched_at_its_control_port(world, start, ros, wait_until):
    from sensor_msgs.msg import Image

    depth = ros.record("camera/depth/image_raw", Image)
    status = diagnostics(ros)
    with world.open() as port:
        start(port.port)
        depth.wait(2)
        start.control.ask("fault", name="depth_empty")
        wait_until(lambda: not np.frombuffer(depth[-1].data, "<u2").any(), 15.0, "an empty depth image")
        wait_until(lambda: status().get("level") == 1 and status().get("faults") == "depth_empty", 15.0, "the warning")
        start.control.ask("fault", name="depth_empty", on=False)
        wait_until(lambda: np.frombuffer(depth[-1].data, "<u2").any(), 15.0, "depth again")


def test_garbled_images_are_refused_by_their_readers(world, start, ros, wait_until):
    from sensor_msgs.msg import Image

    from common.ros.images import array_from_image

    def is_whole(message) -> bool:
        try:
            return array_from_image(message).shape[:2] == (120, 160)
        except ValueError:
            return False

    topics = ("rgb/image_raw", "depth/image_raw", "depth/image")
    images = [ros.record(f"camera/{topic}", Image) for topic in topics]
    with world.open() as port:
        start(port.port, fault="garbled")
        for recording in images:
            recording.wait(8)
            assert not any(map(is_whole, recording))
        start.control.ask("fault", name="garbled", on=False)
        for recording in images:
            wait_until(lambda r=recording: is_whole(r[-1]), 15.0, "a whole image")


def test_a_driver_that_restarts_takes_its_topics_back(world, start, ros, wait_until):
    import rospy
    from sensor_msgs.msg import Image

    def published() -> set:
        return {topic for topic, _ in rospy.get_published_topics("/camera")}

    images = ros.record("camera/rgb/image_raw", Image)
    with world.open() as port:
        start(port.port)
        images.wait(2)
        start.control.ask("fault", name="restarted")
        wait_until(lambda: not published(), 15.0, "the end of the topics")
        before = len(images)
        start.control.ask("fault", name="restarted", on=False)
        images.wait(before + 2)
        assert "/camera/depth/camera_info" in published()


@pytest.mark.parametrize(
    "changes, key",
    [
        ({"fault": "slow::99"}, "~fault"),
        ({"fault": "stuck dance:3"}, "~fault"),
        ({"rate": -1.0}, "~rate"),
        ({"depth": {"quantum": 1.0}}, "~depth/quantum"),
        ({"rgb_calibration": {"distortion_model": "fisheye"}}, "distortion_model"),
    ],
)
def test_bad_parameters_are_refused(ros, changes, key):
    import rospy

    from rig_simulation.ros.camera import main

    rospy.set_param("~", parameters(1, control_port=0, **changes))
    with pytest.raises(RigError, match=key):
        main()


def test_a_control_port_that_is_taken_ends_it_with_a_sentence(world, start, wait_until):
    with world.open() as port:
        process = start(port.port, control_port=port.port)
        wait_until(lambda: process.poll() is not None, 20.0, "the node's end")
    output = process.log_path.read_text()
    assert process.returncode == 1
    assert "127.0.0.1" in output
    assert "Traceback" not in output


def test_it_ends_quietly_when_it_is_interrupted(world, start, ros, processes):
    from sensor_msgs.msg import Image

    with world.open() as port:
        process = start(port.port)
        ros.record("camera/depth_registered/image_raw", Image).wait(1)
        assert processes.end(process) == 0
    assert "Traceback" not in process.log_path.read_text()


def diagnostics(ros):
    """Returns a function that gives the node's last status: its level, message and values."""
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = ros.record("/diagnostics", DiagnosticArray)
    begun = time.time()

    def read() -> dict:
        for array in reversed(arrays):
            for status in array.status:
                if status.name == "camera" and array.header.stamp.to_sec() >= begun:
                    return {"level": status.level, "message": status.message, **{v.key: v.value for v in status.values}}
        return {}

    return read
