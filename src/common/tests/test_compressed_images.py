"""Depth images as image_transport packs them are the images that were packed."""

import struct

import cv2
import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
from sensor_msgs.msg import CompressedImage, Image

from common.ros.compressed_images import depth_from_compressed, depth_topic
from common.ros.images import depth_from_image

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

DEPTH = np.array([[0, 700, 640], [655, 4500, 10000]], np.uint16)


def packed(format, data):
    message = CompressedImage(format=format, data=data)
    message.header.frame_id = "camera"
    return message


def png(pixels) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def as_inverse(depth, nearest=0.3, quantization=100.0) -> bytes:
    """Packs floats as compressed_depth_image_transport does."""
    a = quantization * (quantization + 1.0)
    b = 1.0 - a / 10.0
    with np.errstate(divide="ignore"):
        pixels = np.where(depth > nearest, a / depth + b, 0.0).astype(np.uint16)
    return struct.pack("<i2f", 0, a, b) + png(pixels)


@pytest.mark.parametrize(
    ("format", "data"),
    [
        ("16UC1; compressedDepth", struct.pack("<i2f", 0, 0.0, 0.0) + png(DEPTH)),
        ("16UC1; compressedDepth png", struct.pack("<i2f", 0, 0.0, 0.0) + png(DEPTH)),
        ("16UC1; png compressed ", png(DEPTH)),
        ("png", png(DEPTH)),
        ("32FC1; compressedDepth", as_inverse(0.001 * DEPTH)),
    ],
)
def test_the_depth_that_was_packed_comes_back(format, data):
    image = depth_from_compressed(packed(format, data))
    expected = np.where(DEPTH == 0, np.nan, 0.001 * DEPTH)
    np.testing.assert_allclose(depth_from_image(image), expected, rtol=1e-6 if format[0] != "3" else 0.01)
    assert image.header.frame_id == "camera"


@pytest.mark.parametrize(
    ("format", "data"),
    [
        ("16UC1; compressedDepth rvl", struct.pack("<i2f2i", 0, 0.0, 0.0, 3, 2) + b"\1\2\3\4"),
        ("16UC1; compressedDepth", struct.pack("<i2f", 0, 0.0, 0.0) + png(DEPTH)[:30]),
        ("16UC1; compressedDepth", b""),
        ("mono8; jpeg compressed ", cv2.imencode(".jpg", DEPTH.astype(np.uint8))[1].tobytes()),
        ("8UC1; png compressed ", png(DEPTH.astype(np.uint8))),
        ("bgr8; png compressed bgr8", png(np.zeros((2, 3, 3), np.uint8))),
    ],
)
def test_what_holds_no_depth_is_named(format, data):
    with pytest.raises(ValueError, match=format.split(";")[0]):
        depth_from_compressed(packed(format, data))


def test_a_topic_is_subscribed_to_by_its_type():
    taken = []
    assert depth_topic("camera/depth/image", taken.append) == ("camera/depth/image", Image, taken.append)
    for kind in ("compressed", "compressedDepth"):
        topic, type_, callback = depth_topic(f"/camera/depth/image_raw/{kind}", taken.append)
        callback(packed("16UC1; png compressed ", png(DEPTH)))
        assert topic.endswith(kind) and type_ is CompressedImage and taken.pop().encoding == "16UC1"
