"""What a node needs of its surroundings: the ROS master, still the one that knows it, a host name, a place for logs."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlparse

import rosgraph
import rosgraph.network
import rospkg
import rospy

from common import clock
from common.errors import RigError
from common.ros.files import home
from common.ros.service_calls import MasterLost, ask_master, listens

LOGGERS = "/get_loggers"  # end of the name of a service of rospy in each node
RETRY_S = 0.5
PATIENCE_S = 5.0  # how long a node that starts beside its master waits for it
KEEPALIVE = {socket.TCP_KEEPIDLE: 5, socket.TCP_KEEPINTVL: 2, socket.TCP_KEEPCNT: 3}  # a dead wire shows after 11 s


def check_surroundings() -> None:
    """Raises RigError, with a sentence, if this process cannot be a node with any master; rospy would wait for ever, or
    print a traceback."""
    check_namespace()
    _check_address()
    check_host()
    check_log_folder()


def check_namespace() -> None:
    """Raises RigError if the namespace of this process is no name of ROS."""
    namespace = rosgraph.names.get_ros_namespace()
    if not rosgraph.names.is_legal_name(namespace):
        raise RigError(
            f"The namespace {namespace.strip('/')!r} (ROS_NAMESPACE or __ns:=) must be names of letters, digits and _ "
            "that begin with a letter, as lab1 or lab1/left."
        )


def _check_address() -> None:
    uri = rosgraph.get_master_uri()
    try:
        address = urlparse(uri)
        complete = address.scheme == "http" and address.hostname and address.port
    except ValueError:  # the port is not a number
        complete = None
    if not complete:
        raise NoMaster(f"ROS_MASTER_URI is {uri!r}, but must be like http://localhost:11311.")
    if not _resolved(address.hostname):
        cure = ", or unset ROS_IPV6" if rosgraph.network.use_ipv6() else ""
        cure = ", or set ROS_IPV6=on" if ":" in address.hostname and not cure else cure
        raise NoMaster(f"The host {address.hostname} of ROS_MASTER_URI ({uri}) has no address: correct the name{cure}.")


def check_master(patience: float) -> None:
    """Raises NoMaster unless a ROS master answers; one that starts, or is busy with the nodes that do, has `patience`
    [s]."""
    uri, deadline = rosgraph.get_master_uri(), clock.monotonic() + patience
    while fault := _why_no_master(uri):
        if rospy.core.is_shutdown_requested() or clock.monotonic() >= deadline:
            raise NoMaster(fault)
        clock.sleep(RETRY_S)


def _why_no_master(uri: str) -> str:
    if not listens(uri):
        return f"There is no ROS master at {uri} (ROS_MASTER_URI): start one there, as by roscore, or name another."
    try:
        ask_master("getPid")
    except MasterLost as error:
        return f"{str(error)[:-1]}, or something else listens there: see ROS_MASTER_URI."
    return ""


def check_host() -> None:
    """Raises RigError unless the name or address that this node gives to others is this computer's."""
    host, given = rosgraph.network.get_host_name(), "The name of this computer"
    for name in ("ROS_IP", "ROS_HOSTNAME"):
        given = name if name in os.environ else given
    cure = "so no other node would reach this one: correct it, or set ROS_IP to an address of this computer."
    if not _resolved(host):
        raise RigError(f"{given} is {host!r}, which has no address, {cure}")
    if not rosgraph.network.is_local_address(host):
        raise RigError(f"{given} is {host!r}, which is not an address of this computer, {cure}")


def check_log_folder() -> Path:
    """Returns the folder of this node's logs, which is made; raises RigError if nothing can be written there."""
    log = rosgraph.names.load_mappings(sys.argv).get("__log")
    folder = Path(log).parent if log else Path(rospkg.get_log_dir())
    if str(folder).startswith("~"):
        home()  # raises that there is no home
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise RigError(
            f"No logs can be written to the folder {folder}: {error.strerror}. Set ROS_LOG_DIR to one that can be "
            "written."
        ) from error


def _resolved(host: str) -> bool:
    """Returns whether a host has an address; a name server that is silent knows none."""
    resolve_s = 4.0  # longest time in which a name server answers
    family = socket.AF_INET6 if rosgraph.network.use_ipv6() else socket.AF_INET
    found = []

    def ask() -> None:
        with contextlib.suppress(OSError, UnicodeError):
            found.extend(socket.getaddrinfo(host, None, family))

    asks = clock.Thread(target=ask, name="resolve", daemon=True)
    asks.start()
    asks.join(resolve_s)
    return bool(found)


class NoMaster(RigError):
    """No ROS master runs where ROS_MASTER_URI says."""


class MasterWatch:
    """Keeps a connection to the master open and asks nothing on it, so it costs nothing; its end is that of the master.

    The connections between nodes outlive the master, but nobody finds this node any more. `lost` are called once with
    a sentence when the master is gone. If the one that answers later does not know this node, the node exits.

    Attributes:
        fault: why the node exits, a sentence; None while the master is the same."""

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
                            "it, or its launch file, again."
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
                rospy.logerr(f"{sentence} Beside the next rig, start it again.")
                for call in self.lost:
                    call(sentence)
            clock.sleep(RETRY_S)

    def _connected(self, uri: str) -> socket.socket:
        connect_s = 2.0
        address = urlparse(uri)
        connection = socket.create_connection((address.hostname, address.port), connect_s)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEPALIVE.items():
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
        return connection

    def _wait_for_the_end(self, connection: socket.socket) -> None:
        look_s = 0.5  # longest time until the end of this node is noticed [s]
        while not rospy.core.is_shutdown_requested():
            if select.select([connection], [], [], look_s)[0] and not connection.recv(1):
                return

    def _knows_this_node(self) -> bool:
        """Asks for a service that each node offers from its start: by a topic of which it was in want meanwhile, even
        another master knows it."""
        name = rospy.get_name()
        with contextlib.suppress(rosgraph.MasterError):
            return bool(rosgraph.Master(name).lookupService(f"{name}{LOGGERS}"))
        return False


watch = MasterWatch()
"""That of this process, which `common.ros.node.run` starts."""
