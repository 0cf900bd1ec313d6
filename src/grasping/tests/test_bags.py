"""Recordings of rosbag: the images that are taken out of them, and what is said of those that cannot be read."""

from __future__ import annotations

import shutil
import struct

import cv2
import numpy as np
import pytest
from test_programs import call

from common.errors import RigError

pytest.importorskip("rig_msgs.srv")
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from grasping.lab.ros import depth_images
from grasping.lab.ros.depth_images import opened, topic_in

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

DEPTH, INFO = "/camera/depth/image", "/camera/depth/camera_info"
IMAGES = 6


def depth_message(kind: str = ""):
    depth = np.full((48, 64), 700, np.uint16)
    if kind == "metres as millimetres":
        return Image(height=48, width=64, encoding="32FC1", step=256, data=depth.astype(np.float32).tobytes())
    if not kind:
        return Image(height=48, width=64, encoding="16UC1", step=128, data=depth.tobytes())
    header = struct.pack("<i2f", 0, 0.0, 0.0) if kind == "compressedDepth" else b""
    form = "16UC1; compressedDepth" if header else "16UC1; png compressed "
    return CompressedImage(format=form, data=header + cv2.imencode(".png", depth)[1].tobytes())


def write_bag(path, *, depth=DEPTH, kind="", without=(), slash="/", close=True):
    """Writes a recording; returns its path."""
    import rosbag

    topics = {depth: depth_message(kind), INFO: CameraInfo()}
    bag = rosbag.Bag(str(path), "w")
    for i in range(IMAGES):
        for topic, message in topics.items():
            if topic not in without:
                bag.write(slash + topic.lstrip("/"), message, rospy.Time.from_sec(100.0 + i))
    if close:
        bag.close()
    else:
        bag.flush()
        shutil.copy(path, f"{path}.open")
        bag.close()
        shutil.move(f"{path}.open", path)
    return path


def torn(path, part=0.6):
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])


BAD = {
    "missing.bag": ({}, lambda path: path.unlink(), "missing.bag: No such file"),
    "torn.bag": ({}, torn, "torn.bag (has no index|cannot be read)"),
    "empty.bag": ({}, lambda path: path.write_bytes(b""), "empty.bag cannot be read as a bag"),
    "text.bag": ({}, lambda path: path.write_text("Hello"), "text.bag cannot be read as a bag"),
    "ros2.db3": ({}, lambda path: None, "not a bag of ROS 1; convert .* rosbags-convert"),
    "ros2.mcap": ({}, lambda path: None, "not a bag of ROS 1; convert .* rosbags-convert"),
    "folder.bag": ({}, lambda path: (path.unlink(), path.mkdir()), "not a bag of ROS 1; convert .* rosbags-convert"),
    "open.bag": ({"close": False}, lambda path: None, "has no index: .* Repair it with rosbag reindex"),
    "other.bag": ({"without": [DEPTH]}, lambda path: None, f"has no topic {DEPTH}; it has {INFO}"),
    **{
        f"{kind}.bag": ({"depth": f"{DEPTH}/{kind}", "kind": kind}, lambda path: None, f"give the topic {DEPTH}/{kind}")
        for kind in ("compressedDepth", "compressed")
    },
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_recording_or_lacks_images_is_refused_in_a_sentence(tmp_path, monkeypatch, capsys, name):
    written, damage, said = BAD[name]
    path = write_bag(tmp_path / name, **written)
    damage(path)
    with pytest.raises(RigError, match=said), opened(path) as bag:
        topic_in(bag, path, DEPTH)
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, depth_images, path, tmp_path / "images")
    assert ended.value.code and name in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["", "compressed", "compressedDepth"])
@pytest.mark.parametrize("slash", ["", "/"])
def test_images_are_taken_out_of_a_recording(tmp_path, monkeypatch, capsys, kind, slash):
    topic = f"{DEPTH}/{kind}".rstrip("/")
    path = write_bag(tmp_path / "session 1.bag", depth=topic, kind=kind)
    call(monkeypatch, depth_images, path, tmp_path / "images", "--topic", slash + topic[1:])
    files = sorted((tmp_path / "images").iterdir())
    assert f"{IMAGES} images in" in capsys.readouterr().out and len(files) == IMAGES
    assert (cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED) == 700).all()


def test_images_in_another_unit_are_left_out_and_counted(tmp_path, monkeypatch, capsys):
    path = write_bag(tmp_path / "a.bag", kind="metres as millimetres")
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, depth_images, path, tmp_path / "images")
    streams = capsys.readouterr()
    assert ended.value.code == 1 and f"0 images in {tmp_path / 'images'}; {IMAGES} left out." in streams.out
    assert streams.err.count("the median of the depth is 700 m") == IMAGES
