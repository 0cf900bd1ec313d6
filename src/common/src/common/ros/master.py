"""Whether the ROS master is there, and still the one that knows this node."""

from __future__ import annotations

import contextlib
import select
import socket
from collections.abc import Callable
from urllib.parse import urlparse

import rosgraph
import rospy

from common import clock

RETRY_S = 0.5
LOOK_S = 0.5  # longest time until the end of this node is noticed [s]
CONNECT_S = 2.0
KEEPALIVE = {socket.TCP_KEEPIDLE: 5, socket.TCP_KEEPINTVL: 2, socket.TCP_KEEPCNT: 3}  # a dead wire shows after 11 s


class MasterWatch:
    """Keeps a connection to the master open and asks nothing on it, so it costs nothing; its end is that of the master.

    The connections between nodes outlive the master, but nobody finds this node any more. `lost` are called once with
    a sentence when the master is gone. If the one that answers later does not know this node, the node exits.

    Attributes:
        fault: why the node exits, a sentence; None while the master is the same.
    """

    def __init__(self) -> None:
        self.lost: list[Callable[[str], None]] = []
        self.fault: str | None = None

    def start(self) -> None:
        """Watches in a thread of its own until ROS shuts down."""
        clock.Thread(target=self._run, name="master watch", daemon=True).start()

    def _run(self) -> None:
        uri, gone = rosgraph.get_master_uri(), False
        while not rospy.core.is_shutdown_requested():
            try:
                with self._connected(uri) as connection:
                    if gone and not self._knows_this_node():
                        self.fault = (
                            f"The ROS master at {uri} was started anew and does not know this node, which exits: start "
                            "the launch file again."
                        )
                        rospy.logfatal(self.fault)
                        rospy.signal_shutdown("the ROS master was started anew")
                        return
                    if gone:
                        rospy.logwarn("The ROS master at %s answers again.", uri)
                    gone = False
                    self._wait_for_the_end(connection)
            except OSError:
                pass
            if rospy.core.is_shutdown_requested():
                return
            if not gone:
                gone = True
                sentence = f"The ROS master at {uri} is gone: nobody can call a service of this node any more."
                rospy.logerr(sentence)
                for call in self.lost:
                    call(sentence)
            clock.sleep(RETRY_S)

    def _connected(self, uri: str) -> socket.socket:
        address = urlparse(uri)
        connection = socket.create_connection((address.hostname, address.port), CONNECT_S)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEPALIVE.items():
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
        return connection

    def _wait_for_the_end(self, connection: socket.socket) -> None:
        while not rospy.core.is_shutdown_requested():
            if select.select([connection], [], [], LOOK_S)[0] and not connection.recv(1):
                return

    def _knows_this_node(self) -> bool:
        name = rospy.get_name()
        with contextlib.suppress(rosgraph.MasterError):
            return bool(rosgraph.Master(name).lookupNode(name))
        return False


watch = MasterWatch()
"""That of this process, which `common.ros.node.run` starts."""
