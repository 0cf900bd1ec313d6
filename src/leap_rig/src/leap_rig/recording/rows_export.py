"""Recordings as one MCAP file of the rows of a dataset: a JSON message for each key at each row, which Foxglove plots.

/observation.flange_force ...   {"x": 1.0, ...} by the names; their unit is the schema's description
/observation.images.color       foxglove.CompressedImage, PNG
/policy_led, /intervention     {"policy_led": true}: who gave the action of the row
metadata `episode`              task, first and last row [ns], and what its label says
attachment leap_rig.json        units, and where each episode comes from"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import Writer

from leap_rig.recording.dataset import ExportedEpisode, about, exported_episodes
from leap_rig.recording.recording_files import new_file

NUMBER = {"type": "number"}
TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
IMAGE_SCHEMA = {
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
    },
}  # https://docs.foxglove.dev/docs/sdk/schemas/compressed-image


def export(recordings: Sequence[Path], path: Path, fps: int, task: str, **cut: Any) -> int:
    """Writes one file of `exported_episodes`, which takes the `cut`, and returns the number of rows. Raises
    RecordingFault if the file exists or the disk does not take it, or as they do."""
    episodes = exported_episodes(recordings, fps, task, **cut)
    with new_file(path) as file:
        writer: Any = Writer(file)
        writer.start("", library="leap_rig")
        said = about(episodes)
        writer.add_attachment(0, 0, "leap_rig.json", "application/json", json.dumps(said).encode())
        channels = _channels(writer, episodes[0], said["units"])
        for one in episodes:
            _write(writer, channels, one)
        writer.finish()
    return sum(len(one.rows.times) for one in episodes)


def _channels(writer: Any, one: ExportedEpisode, units: Mapping[str, str]) -> dict[str, int]:
    image = writer.register_schema("foxglove.CompressedImage", "jsonschema", json.dumps(IMAGE_SCHEMA).encode())
    channels = {key: writer.register_channel(f"/{key}", "json", image) for key in one.cameras}
    for key in one.vectors():
        properties = {name: NUMBER for name in one.features[key]["names"]}
        schema = {"type": "object", "description": units[key], "properties": properties}
        kind = writer.register_schema(key, "jsonschema", json.dumps(schema).encode())
        channels[key] = writer.register_channel(f"/{key}", "json", kind)
    for key in one.leader:
        schema = {"type": "object", "properties": {key: {"type": "boolean"}}}
        kind = writer.register_schema(key, "jsonschema", json.dumps(schema).encode())
        channels[key] = writer.register_channel(f"/{key}", "json", kind)
    return channels


def _write(writer: Any, channels: Mapping[str, int], one: ExportedEpisode) -> None:
    times = np.round(1e9 * one.rows.times).astype(np.int64).tolist()
    said = {key: str(value) for key, value in one.about.items()}
    writer.add_metadata("episode", {**said, "task": one.task, "first_ns": str(times[0]), "last_ns": str(times[-1])})
    vectors, images = one.vectors(), one.images()
    for i, time in enumerate(times):
        for key, rows in vectors.items():
            _add(writer, channels[key], time, dict(zip(one.features[key]["names"], rows[i].tolist())))
        for key, rows in one.leader.items():
            _add(writer, channels[key], time, {key: bool(rows[i])})
        for key, of in images.items():
            packed = cv2.imencode(".png", cv2.cvtColor(next(of), cv2.COLOR_RGB2BGR))[1].tobytes()
            stamp = {"sec": time // 10**9, "nsec": time % 10**9}
            data = base64.b64encode(packed).decode()
            _add(writer, channels[key], time, {"timestamp": stamp, "frame_id": "", "data": data, "format": "png"})


def _add(writer: Any, channel: int, time: int, message: Mapping[str, Any]) -> None:
    writer.add_message(channel, time, json.dumps(message).encode(), time)
