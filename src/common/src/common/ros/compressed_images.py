"""Images as image_transport compresses them: topics NAME/compressed (PNG of depth, JPEG of
color) and NAME/compressedDepth."""

from __future__ import annotations

import struct
from collections.abc import Callable

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

from common.ros.images import colour_from_image, image_message

COMPRESSED = ("compressedDepth", "compressed")  # last part of a topic's name, best first
HEADER = struct.Struct("<i2f")  # of compressedDepth: kind, and A and B of inverse depths
PNG = b"\x89PNG"
ENCODINGS = {"uint16": "16UC1", "float32": "32FC1"}


def depth_topic(topic: str, callback: Callable[[Image], None]) -> tuple[str, type, Callable]:
    """Returns topic, type and callback to subscribe to depth images; compressed ones become images."""
    if topic.rpartition("/")[2] in COMPRESSED:
        return topic, CompressedImage, lambda message: callback(depth_from_compressed(message))
    return topic, Image, callback


def depth_from_compressed(message: CompressedImage) -> Image:
    """Returns the depth image of a message, 16UC1 or 32FC1; raises ValueError if it holds none."""
    data, inverse = bytes(message.data), (0.0, 0.0)
    if "compressedDepth" in message.format and len(data) > HEADER.size:
        _, *inverse = HEADER.unpack_from(data)
        data = data[HEADER.size :]
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data.startswith(PNG) else None
    if pixels is None or pixels.ndim != 2 or pixels.dtype != np.uint16:
        raise ValueError(f"a compressed image of the format {message.format!r} is no depth image; use 16-bit PNG")
    if message.format.startswith("32FC1"):
        with np.errstate(divide="ignore"):
            metres = np.float32(inverse[0]) / (pixels - np.float32(inverse[1]))
        pixels = np.where(pixels == 0, np.float32(np.nan), metres).astype(np.float32)
    return image_message(pixels, ENCODINGS[pixels.dtype.name], message.header.frame_id, message.header.stamp)


def jpeg_from_image(message: Image, quality: int) -> CompressedImage:
    """Returns a colour image as JPEG of this quality [%]; raises ValueError for another encoding or incomplete data."""
    _, jpeg = cv2.imencode(".jpg", colour_from_image(message)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return CompressedImage(message.header, f"{message.encoding}; jpeg compressed bgr8", jpeg.tobytes())
