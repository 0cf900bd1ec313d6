"""Recordings of rosbag: opened, or refused in a sentence; their topics are found with or without a leading slash."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rosbag

from common.errors import RigError
from common.ros.compressed_images import COMPRESSED

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
