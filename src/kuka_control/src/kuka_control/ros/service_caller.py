"""Service calls with a time-out that also work while the ROS master is away.

rospy.ServiceProxy waits for ever for a node that hangs, and asks the master before every call. Here a request is sent
only after the node has answered the handshake, so a node that hangs never carries out a request that was given up.
"""

from __future__ import annotations

import http.client
import io
import socket
import struct
import time
import xmlrpc.client
from collections.abc import Iterable

import rosgraph
import rosgraph.network
import rospy

from common.errors import RigError

MASTER_TIMEOUT_S = 2.0


class MasterLost(RigError):
    """The ROS master does not answer."""


class CallFailed(RigError):
    """A service call brought no answer; the sentence says whether the request may have been carried out."""


class NotThere(CallFailed):
    """Nobody offers the service at the address that was known."""


class ServiceCaller:
    """Calls services of one node by their last known addresses.

    Args:
        names: the services whose addresses are kept.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._names = tuple(names)
        self._addresses: dict[str, tuple[str, int]] = {}

    def refresh(self) -> None:
        """Asks the master where the services are; what it does not know keeps its last address.

        Raises:
            MasterLost: the master does not answer.
        """
        for name in self._names:
            self._look_up(name, MASTER_TIMEOUT_S)

    def call(self, name: str, kind, *values, timeout: float):
        """Calls a service and returns its response.

        Args:
            name: name of the service.
            kind: its type.
            values: the fields of the request.
            timeout: longest wait for the answer [s].

        Raises:
            CallFailed: there was no answer in time, or none at all.
        """
        deadline = time.monotonic() + timeout
        known = self._addresses.get(name)
        failure = NotThere("The controller is out of reach.")
        if known is not None:
            try:
                return _call(known, rospy.resolve_name(name), kind, kind._request_class(*values), deadline)
            except NotThere as error:
                failure = error  # it may have been started again since
        try:
            found = self._look_up(name, _left(deadline))
        except MasterLost as error:
            raise NotThere(f"{failure} {error}") from error
        if found is None or found == known:
            raise failure
        return _call(found, rospy.resolve_name(name), kind, kind._request_class(*values), deadline)

    def _look_up(self, name: str, timeout: float) -> tuple[str, int] | None:
        uri = ask_master("lookupService", rospy.resolve_name(name), timeout=timeout)
        if uri is None:
            return None
        # Names become numbers here, so that no call waits for a name server.
        family = socket.AF_INET6 if rosgraph.network.use_ipv6() else socket.AF_INET
        try:
            found = socket.getaddrinfo(*rospy.core.parse_rosrpc_uri(uri), family, socket.SOCK_STREAM)
        except OSError:
            return None
        self._addresses[name] = found[0][4][:2]
        return self._addresses[name]


def ask_master(method: str, *arguments, timeout: float = MASTER_TIMEOUT_S):
    """Calls a method of the ROS master's interface and returns its value, None if the master says no.

    Raises:
        MasterLost: the master does not answer within `timeout` [s].
    """
    uri = rosgraph.get_master_uri()
    master = xmlrpc.client.ServerProxy(uri, transport=_Transport(timeout))
    try:
        code, _, value = getattr(master, method)(rospy.get_caller_id(), *arguments)
    except (OSError, xmlrpc.client.Error, http.client.HTTPException) as error:
        raise MasterLost(f"The ROS master at {uri} does not answer.") from error
    return value if code == 1 else None


class _Transport(xmlrpc.client.Transport):
    """HTTP with a time-out."""

    def __init__(self, timeout: float) -> None:
        super().__init__()
        self._timeout = timeout

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = self._timeout
        return connection


def _call(address: tuple[str, int], name: str, kind, request, deadline: float):
    """One call over TCPROS: headers both ways, then the request, then the answer."""
    sent = False
    try:
        with socket.create_connection(address, _left(deadline)) as connection:
            _shake_hands(connection, name, kind, deadline)
            body = io.BytesIO()
            request.serialize(body)
            sent = True
            connection.sendall(struct.pack("<I", body.tell()) + body.getvalue())
            connection.settimeout(_left(deadline))
            done, length = struct.unpack("<BI", _receive(connection, 5, deadline))
            answer = _receive(connection, length, deadline)
    except socket.timeout as error:
        what = "it may still do what was asked for" if sent else "nothing was asked for"
        raise CallFailed(f"The controller has not answered in time: {what}.") from error
    except (OSError, rosgraph.network.ROSHandshakeException) as error:
        if sent:
            raise CallFailed("The controller ended the connection before its answer.") from error
        raise NotThere("The controller is out of reach.") from error
    if not done:
        raise CallFailed(f"The controller failed: {answer.decode(errors='replace')}")
    return kind._response_class().deserialize(answer)


def _shake_hands(connection: socket.socket, name: str, kind, deadline: float) -> None:
    header = {"service": name, "md5sum": kind._md5sum, "type": kind._type, "callerid": rospy.get_caller_id()}
    connection.settimeout(_left(deadline))
    rosgraph.network.write_ros_handshake_header(connection, header)
    answer = rosgraph.network.read_ros_handshake_header(connection, io.BytesIO(), 4096)
    if "error" in answer:
        raise NotThere(f"{name} is not offered: {answer['error']}.")


def _receive(connection: socket.socket, count: int, deadline: float) -> bytes:
    data = b""
    while len(data) < count:
        connection.settimeout(_left(deadline))
        part = connection.recv(count - len(data))
        if not part:
            raise ConnectionError("the connection ended")
        data += part
    return data


def _left(deadline: float) -> float:
    """Returns the time until the deadline, never zero, which would mean not to wait at all [s]."""
    return max(deadline - time.monotonic(), 1e-3)
