"""Camera messages: there and back, padding, byte order, and what is refused."""

import numpy as np
import pytest

from common.camera_model import pinhole

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros


def messages():
    import rospy

    from common.ros import images

    return images, rospy.Time(3, 4)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "rgb8", "bgr8", "mono16", "16UC1", "32FC1"])
def test_a_picture_comes_back_from_its_message(encoding):
    images, stamp = messages()
    kind, channels = images.TYPES[encoding]
    picture = np.random.default_rng(1).integers(0, 255, (4, 5, channels)).astype(kind)
    picture = picture if channels > 1 else picture[..., 0]
    message = images.image_message(picture, encoding, "camera_frame", stamp)
    assert (message.header.frame_id, message.header.stamp, message.encoding) == ("camera_frame", stamp, encoding)
    np.testing.assert_array_equal(images.array_from_image(message), picture)


def test_padded_rows_and_foreign_byte_order_are_understood():
    images, stamp = messages()
    message = images.image_message(np.arange(6, dtype=np.uint16).reshape(2, 3), "16UC1", "f", stamp)
    message.data = b"\0\0\0\1\0\2xx\0\3\0\4\0\5xx"
    message.step, message.is_bigendian = 8, 1
    np.testing.assert_array_equal(images.array_from_image(message), [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    "change, complaint",
    [
        ({"encoding": "yuv422"}, "yuv422"),
        ({"data": b"abc"}, "3 bytes"),
        ({"width": 0}, "0 x"),
        ({"step": 1}, "rows of 1"),
    ],
)
def test_a_broken_picture_is_refused(change, complaint):
    images, stamp = messages()
    message = images.image_message(np.zeros((2, 3), np.uint16), "16UC1", "f", stamp)
    for key, value in change.items():
        setattr(message, key, value)
    with pytest.raises(ValueError, match=complaint):
        images.array_from_image(message)


def test_an_array_of_another_type_is_no_picture():
    images, stamp = messages()
    with pytest.raises(ValueError, match="float64"):
        images.image_message(np.zeros((2, 3)), "32FC1", "f", stamp)


def test_a_camera_comes_back_from_its_message():
    images, stamp = messages()
    model = pinhole("f", 640, 480, [[525.0, 0, 319.5], [0, 524.0, 239.5], [0, 0, 1]])
    back = images.camera_model_from_info(images.camera_info_message(model, "f", stamp))
    for name in ("K", "D", "R", "P"):
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))


def test_an_uncalibrated_camera_is_refused():
    images, stamp = messages()
    message = images.camera_info_message(pinhole("f", 4, 3, np.eye(3)), "f", stamp)
    message.K = [0.0] * 9
    with pytest.raises(ValueError, match="not calibrated"):
        images.camera_model_from_info(message)


def test_depth_in_metres_says_nan_where_there_is_none():
    images, _ = messages()
    metres = images.metres_from_millimetres(np.array([[0, 1, 3500]], np.uint16))
    assert metres.dtype == np.float32
    np.testing.assert_allclose(metres, [[np.nan, 0.001, 3.5]])


def test_colour_comes_red_first_and_depth_in_metres_whatever_the_encoding():
    images, stamp = messages()
    colour = np.array([[[200, 20, 2]]], np.uint8)
    for encoding, picture in (("rgb8", colour), ("bgr8", colour[..., ::-1].copy())):
        np.testing.assert_array_equal(
            images.colour_from_image(images.image_message(picture, encoding, "f", stamp)), colour
        )
    for encoding, picture in (("16UC1", np.array([[1500]], np.uint16)), ("32FC1", np.array([[1.5]], np.float32))):
        np.testing.assert_allclose(
            images.depth_from_image(images.image_message(picture, encoding, "f", stamp)), [[1.5]]
        )
    with pytest.raises(ValueError, match="mono8"):
        images.colour_from_image(images.image_message(np.zeros((1, 1), np.uint8), "mono8", "f", stamp))
    with pytest.raises(ValueError, match="rgb8"):
        images.depth_from_image(images.image_message(colour, "rgb8", "f", stamp))
