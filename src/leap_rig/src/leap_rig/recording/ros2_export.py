"""A recording as a bag of ROS 2, by rosbags: an MCAP file with its metadata. Runs in the environment of
requirements-ros2.txt, without ROS 1."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path

from rosbags.convert.converter import LATCH
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from common.errors import RigError
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.ros2.conversions import Ros2Conversions, ros2_name


def main() -> None:
    """Exports what the only argument describes in JSON; what ends it goes to stderr."""
    interrupted = 130  # exit code after Ctrl-C
    try:
        options = json.loads(sys.argv[1])
        wanted, start, end = options["topics"], options["start"], options["end"]
        export(Path(options["recording"]), Path(options["folder"]), wanted, start, end)
    except (RigError, OSError) as error:
        sys.exit(f"export_recording: {error}")
    except KeyboardInterrupt:
        sys.exit(interrupted)


def export(recording: Path, folder: Path, wanted: Iterable[str] | None, start: float, end: float) -> None:
    """Writes the messages of the `wanted` topics, of all for None, between these times [s]. Raises RecordingFault if
    the folder exists, or a message does not match its type."""
    version = 9  # of the metadata: Jazzy and later
    if folder.exists():
        raise RecordingFault(f"{folder} exists already, and nothing is overwritten; choose another folder.")
    conversions, known = Ros2Conversions(), {}
    writer = Writer(folder, version=version, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        for message in between(recording, wanted, start, end):
            kind, key = message.kind.name, (message.topic, message.kind)
            try:
                if key not in known:
                    conversions.learn(kind, message.kind.definition)
                    quality = LATCH if message.kind.is_latched else ()
                    known[key] = writer.add_connection(
                        message.topic, ros2_name(kind), typestore=conversions.store, offered_qos_profiles=quality
                    )
                writer.write(known[key], message.received, conversions.to_ros2(kind, message.data))
            except (SerdeError, TypesysError) as error:
                raise RecordingFault(f"A message on {message.topic} is no {kind}: {error}.") from error
