"""The other end of lerobot_server.py of Leap Rig: one request after the other on a socket of this machine.

A message is `LEAP`, the version (2 bytes), the sizes of its JSON and of its images (4 bytes each), the JSON, and the
images, all big-endian. The JSON's entry `images` names the images in their order, with their sizes."""

from __future__ import annotations

import json
import os
import socket
import struct
from pathlib import Path
from typing import Any, Mapping

MAGIC, VERSION = b"LEAP", 1
HEAD = struct.Struct(">4sHII")
LARGEST = 2**26  # bytes of the images
TIMEOUT_S = 5.0
POSE = tuple(f"tool.{part}" for part in ("x", "y", "z", "qx", "qy", "qz", "qw"))
FINGERS = tuple(f"{motor}.pos" for motor in ("index", "middle", "thumb", "spread"))
JOINTS = tuple(f"kuka_joint_{i}" for i in range(1, 8))
ACTION = POSE + FINGERS
STATE = (*(f"{name}.pos" for name in JOINTS), *(f"{name}.torque" for name in JOINTS), *FINGERS, *POSE)


class RigLinkError(ConnectionError):
    """The rig does not answer, or refuses; the text is one sentence."""


def default_path() -> Path:
    """Returns where lerobot_server.py listens."""
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "leap_rig" / "lerobot.sock"


class RigLink:
    """A connection to lerobot_server.py; one thread uses it."""

    def __init__(self, path: str = "") -> None:
        self._path = Path(path) if path else default_path()
        self._socket: socket.socket | None = None
        self.moves = False

    @property
    def is_connected(self) -> bool:
        return self._socket is not None

    def connect(self) -> None:
        """Connects; raises RigLinkError if nobody answers, or another version does."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(TIMEOUT_S)
        try:
            self._socket.connect(str(self._path))
        except OSError as error:
            self.close()
            start = "start `rosrun leap_rig lerobot_server.py`"
            raise RigLinkError(
                f"Leap Rig does not answer on {self._path} ({error.strerror or error}); {start}."
            ) from error
        said, _ = self.ask("hello")
        self.moves = bool(said.get("moves"))
        if tuple(said.get("action", ())) != ACTION:
            self.close()
            raise RigLinkError(f"Leap Rig names the actions {said.get('action')}, but {', '.join(ACTION)} are known.")

    def ask(self, do: str, **values: Any) -> tuple[dict[str, Any], dict[str, bytes]]:
        """Returns the answer to a request, and its images; raises RigLinkError, after which only a `fault` of the rig
        leaves the connection open."""
        if self._socket is None:
            raise RigLinkError("Leap Rig is not connected.")
        try:
            text = json.dumps({"do": do, **values, "images": {}}, allow_nan=False).encode()
        except ValueError as error:
            raise RigLinkError(f"The request {do} is not sent: {error}.") from error
        try:
            self._socket.sendall(HEAD.pack(MAGIC, VERSION, len(text), 0) + text)
            said, images = self._received()
        except (OSError, KeyError, TypeError, ValueError, AttributeError, struct.error) as error:
            self.close()
            raise RigLinkError(f"The answer to {do} cannot be read, so the connection is closed: {error}.") from error
        if said.get("fault"):
            raise RigLinkError(str(said["fault"]))
        return said, images

    def close(self) -> None:
        """Closes the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _received(self) -> tuple[dict[str, Any], dict[str, bytes]]:
        magic, version, length, size = HEAD.unpack(self._exactly(HEAD.size))
        if magic != MAGIC or version != VERSION or length + size > LARGEST:
            raise ValueError(f"it begins with {magic!r}, version {version}, and {length} and {size} bytes")
        said, data = json.loads(self._exactly(length)), self._exactly(size)
        images, at = {}, 0
        for name, one in said.pop("images").items():
            images[name], at = data[at : at + one], at + one
        if at != size:
            raise ValueError(f"it names images of {at} bytes, but holds {size}")
        return said, images

    def _exactly(self, count: int) -> bytes:
        assert self._socket is not None
        data = bytearray()
        while len(data) < count:
            part = self._socket.recv(min(count - len(data), 2**16))
            if not part:
                raise ConnectionError("the rig has closed it")
            data += part
        return bytes(data)


def finite_action(action: Mapping[str, Any]) -> dict[str, float]:
    """Returns an action as plain numbers, also of an array or a tensor."""
    return {name: float(action[name]) for name in ACTION}
