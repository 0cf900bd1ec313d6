"""A plain client of the simulated controller, on wires in virtual time."""

from __future__ import annotations

from common import clock
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_urdf

ROBOT = Robot(read_urdf("LBR7R800", "MF_elektrisch"))


class ToolboxClient:
    """A client of the toolbox port."""

    def __init__(self, wires, server):
        self.socket = wires.connect((server.host, server.port))
        self.socket.settimeout(60.0)
        self.replies = self.socket.makefile("rb")

    def send(self, text):
        """Sends it as it is."""
        self.socket.sendall(text.encode())

    def hear(self):
        """Returns the next line."""
        return self.replies.readline().decode("latin-1")

    def ask(self, line="getJointsPositions"):
        """Sends a line; returns its answer."""
        self.send(f"{line}\n")
        return self.hear()

    def silent(self, seconds):
        """Returns whether nothing comes for so many seconds."""
        clock.sleep(seconds)
        return self.socket.readable_at() > clock.monotonic()

    def at_end(self):
        """Returns whether the connection ends, in order and without a further word."""
        return self.replies.read() == b""

    def close(self):
        """Goes without a word."""
        self.replies.close()
        self.socket.close()
