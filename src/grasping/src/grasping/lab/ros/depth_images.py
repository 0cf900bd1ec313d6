"""Takes depth images out of a bag as 16-bit PNG files in millimetres, one every so many seconds of the recording.

A file's name is the bag's and the image's stamp; what is there already is not written again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import rosbag
from sensor_msgs.msg import CompressedImage

from common.errors import RigError
from common.ros.compressed_images import COMPRESSED, depth_from_compressed
from common.ros.images import depth_from_image

ROS_2 = (".db3", ".mcap")


@contextmanager
def opened(path: Path) -> Iterator[rosbag.Bag]:
    """Opens a recording; raises RigError if it is not a bag of ROS 1, or if reading it fails."""
    if path.is_dir() or path.suffix.lower() in ROS_2:
        raise RigError(f"{path} is not a bag of ROS 1; convert recordings of ROS 2 with rosbags-convert.")
    try:
        with rosbag.Bag(str(path)) as bag:
            yield bag
    except rosbag.ROSBagUnindexedException:
        raise RigError(f"{path} has no index: its recording was cut off. Repair it with rosbag reindex.") from None
    except RigError:
        raise
    except OSError as error:
        raise RigError(f"{error.filename or path}: {error.strerror or error}.") from None
    except Exception as error:  # of a damaged bag: struct.error, KeyError, those of the compressions and of genpy
        raise RigError(f"{path} cannot be read as a bag: {error or type(error).__name__}.") from None


def topic_in(bag: rosbag.Bag, path: Path, name: str) -> str:
    """Returns a topic as the bag at `path` names it, with or without a slash; raises RigError if it has none."""
    topics = {topic.strip("/"): topic for topic in bag.get_type_and_topic_info().topics}
    plain = name.strip("/")
    if plain in topics:
        return topics[plain]
    packed = [topics[f"{plain}/{kind}"] for kind in COMPRESSED if f"{plain}/{kind}" in topics]
    hint = f"give the topic {packed[0]}" if packed else f"it has {', '.join(sorted(topics.values())) or 'none'}"
    raise RigError(f"{path} has no topic {name}; {hint}.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path, help="recording with depth images, 16UC1, 32FC1 or compressed")
    parser.add_argument("folder", type=Path, help="where the images go")
    parser.add_argument("--topic", default="/camera/depth/image", help="default: %(default)s")
    parser.add_argument("--every", type=float, default=1.0, help="seconds between two images, default 1")
    arguments = parser.parse_args()
    if not 0.0 <= arguments.every < 1e6:
        parser.error(f"--every is {arguments.every:g} and must be 0 to 1e6 seconds.")
    written, left_out, last = 0, 0, -np.inf
    try:
        arguments.folder.mkdir(parents=True, exist_ok=True)
        with opened(arguments.bag) as bag:
            topic = topic_in(bag, arguments.bag, arguments.topic)
            for _, message, stamp in bag.read_messages(topics=[topic]):
                if stamp.to_sec() < last + arguments.every:
                    continue
                try:
                    packed = message._type == CompressedImage._type
                    depth = depth_from_image(depth_from_compressed(message) if packed else message)
                except ValueError as error:
                    sys.stderr.write(f"Left out, at {stamp.to_sec():.3f} s: {error}\n")
                    left_out += 1
                    continue
                last = stamp.to_sec()
                path = arguments.folder / f"{arguments.bag.stem}_{stamp.to_nsec() // 10**6}.png"
                if not path.exists():
                    written += 1
                    cv2.imwrite(str(path), in_millimetres(depth))
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename or arguments.folder}: {error.strerror or error}.")
    print(f"{written} images in {arguments.folder}{f'; {left_out} left out' if left_out else ''}.")
    if left_out and last == -np.inf:
        sys.exit(1)


def in_millimetres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image [m] as 16-bit millimetres, 0 where there is no reading or none that fits."""
    largest_mm = 2**16 - 1
    fits = np.isfinite(depth) & (depth > 0.0) & (depth < largest_mm * 1e-3)
    return np.round(np.where(fits, depth, 0.0) * 1e3).astype(np.uint16)
