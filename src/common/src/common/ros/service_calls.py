"""Service calls that return in time, whatever the node that offers the service and the ROS master do.

`rospy.ServiceProxy` waits for ever for a node that hangs, and asks the master before every call. Here each call runs in
a thread of its own, and a `ServiceClient` keeps the service's address. The request is sent after the node has answered
the handshake, and only if the caller still waits: a node that hangs never executes a call that was given up before.
A call that was given up ends too, so a node that hangs costs one thread and one socket at most per client."""

from __future__ import annotations

import contextlib
import http.client
import socket
import struct
import xmlrpc.client
from collections.abc import Callable
from typing import Any
from urllib.parse import urlparse
from xml.parsers.expat import ExpatError

import rosgraph
import rosgraph.network
import rospy
from rospy.impl.tcpros_base import TCPROSTransport

from common import clock
from common.errors import DeviceError, RigError

HANDSHAKE_TIMEOUT_S = 5.0


class MasterLost(RigError):
    """The ROS master does not answer."""


class ServiceFailed(DeviceError):
    """No answer from `service` (the message ends a sentence); if the request was `sent`, the node may execute it."""

    def __init__(self, service: str, reason: str, sent: bool) -> None:
        super().__init__(f"the service {service} {reason}")
        self.service = service
        self.sent = sent


class ServiceAbsent(ServiceFailed):
    """No node offers the service."""

    def __init__(self, service: str, reason: str) -> None:
        super().__init__(service, f"is not offered: {reason}", sent=False)


class ServiceClient:
    """Calls one service of the type `kind` by its last known address."""

    def __init__(self, name: str, kind: type) -> None:
        self.name = name
        self._kind = kind
        self._address: tuple[str, int] | None = None
        self._unfinished: _Attempt | None = None  # given up, but not ended

    def look_up(self) -> bool:
        """Asks the master for the address and returns whether it knows one; a service that it does not know keeps its
        last one. Raises MasterLost if the master does not answer."""
        uri = ask_master("lookupService", rospy.resolve_name(self.name))
        if uri is not None:
            family = socket.AF_INET6 if rosgraph.network.use_ipv6() else socket.AF_INET
            try:  # a number, so that no later call waits for a name server
                found = socket.getaddrinfo(*rospy.core.parse_rosrpc_uri(uri), family, socket.SOCK_STREAM)
            except OSError:
                return True
            self._address = found[0][4][:2]
        return uri is not None

    def __call__(self, *values, timeout: float, wait: float = 0.0, wanted: Callable[[], bool] = lambda: True):
        """Returns the response to a request with these fields, within `timeout` [s] after up to `wait` [s] for a node
        that offers the service; raises ServiceFailed if no node offers it, it failed, it did not answer in time, or it
        was not `wanted` any more when the node could take it."""
        start, before = clock.monotonic(), self._unfinished
        if before is not None and not before.done.wait(wait + timeout):
            raise ServiceFailed(self.name, "still does not answer: nothing was requested", False)
        wait = max(0.0, wait - (clock.monotonic() - start)) if before is not None else wait
        proxy, request = rospy.ServiceProxy(self.name, self._kind), self._kind._request_class(*values)
        attempt = _Attempt(self, proxy, request, wait, wanted)
        try:
            return attempt.response(wait + timeout)
        finally:
            self._unfinished = None if attempt.done.is_set() else attempt

    def connected(self, proxy: rospy.ServiceProxy) -> TCPROSTransport:
        """Returns a connection to the node, after the handshake; raises ServiceAbsent if none offers the service."""
        known, reason = self._address, "nobody offers it"
        if known is not None:
            try:
                return _connection(proxy, known)
            except socket.timeout as error:
                raise ServiceFailed(self.name, str(error), sent=False) from error
            except rospy.exceptions.TransportInitError as error:  # perhaps the node was started again elsewhere
                reason = str(error)
        try:
            self.look_up()
            if self._address not in (None, known):
                return _connection(proxy, self._address)
        except socket.timeout as error:
            raise ServiceFailed(self.name, str(error), sent=False) from error
        except (MasterLost, rospy.exceptions.TransportInitError) as error:
            reason = str(error).rstrip(".")
        raise ServiceAbsent(self.name, reason)


def call(name: str, kind: type, *values, timeout: float, wait: float = 0.0):
    """Calls a service once, as a `ServiceClient` does."""
    return ServiceClient(name, kind)(*values, timeout=timeout, wait=wait)


class _Attempt:
    """One call in a thread of its own."""

    def __init__(
        self,
        client: ServiceClient,
        proxy: rospy.ServiceProxy,
        request: Any,
        wait: float,
        wanted: Callable[[], bool],
    ) -> None:
        self._client = client
        self._proxy = proxy
        self._request = request
        self._wait = wait
        self._wanted = wanted
        self._lock = clock.Lock()
        self.done = clock.Event()
        self._given_up = self._sent = False
        self._response = None
        self._failure = None
        clock.Thread(target=self._run, name=client.name, daemon=True).start()

    def response(self, timeout: float):
        """Returns the response, or gives the call up after `timeout` [s]."""
        if not self.done.wait(timeout):
            with self._lock:
                self._given_up = True
            if self._sent:
                self._hang_up()
            outcome = "it may still execute the request" if self._sent else "nothing was requested"
            raise ServiceFailed(self._client.name, f"did not answer within {timeout:g} s: {outcome}", self._sent)
        if self._failure is not None:
            raise self._failure
        return self._response

    def _run(self) -> None:
        name = self._client.name
        try:
            if self._wait > 0.0:
                rospy.wait_for_service(name, self._wait)
            self._proxy.transport = self._client.connected(self._proxy)
            with self._lock:
                self._sent = not self._given_up and self._wanted()
            if self._sent:
                self._response = self._proxy.call(self._request)
            else:
                self._proxy.transport.close()
                self._failure = ServiceFailed(name, "was not asked: it was taken back before", sent=False)
        except ServiceFailed as failure:
            self._failure = failure
        except (rospy.ServiceException, rospy.ROSException, rospy.exceptions.TransportException, OSError) as error:
            text = str(error)
            self._failure = ServiceFailed(name, f"failed: {text}", True) if self._sent else ServiceAbsent(name, text)
        finally:
            self.done.set()

    def _hang_up(self) -> None:
        with contextlib.suppress(AttributeError, OSError):  # it ended meanwhile
            self._proxy.transport.socket.shutdown(socket.SHUT_RDWR)


def _connection(proxy: rospy.ServiceProxy, address: tuple[str, int]) -> TCPROSTransport:
    transport = _Transport(proxy.protocol, proxy.resolved_name)
    transport.buff_size = proxy.buff_size
    try:
        transport.connect(*address, proxy.resolved_name, timeout=HANDSHAKE_TIMEOUT_S)
    except rospy.exceptions.TransportInitError as error:
        transport.close()
        if isinstance(error.__context__, (BlockingIOError, socket.timeout)):
            raise socket.timeout(f"did not answer the handshake within {HANDSHAKE_TIMEOUT_S:g} s") from error
        raise
    transport.limit_reception(0.0)
    return transport


class _Transport(TCPROSTransport):
    """A connection that waits for the handshake for HANDSHAKE_TIMEOUT_S at most."""

    def write_header(self):
        self.limit_reception(HANDSHAKE_TIMEOUT_S)  # read_header undoes a time-out of Python's
        super().write_header()

    def limit_reception(self, seconds: float) -> None:
        """Limits how long the system waits for data; 0 is without a limit."""
        whole = int(seconds)
        limit = struct.pack("@ll", whole, int(1e6 * (seconds - whole)))
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)


def ask_master(method: str, *arguments):
    """Returns the value of a method of the ROS master's interface, None if the master has none; raises MasterLost if it
    does not answer within 2 s."""
    uri = rosgraph.get_master_uri()
    try:
        master = xmlrpc.client.ServerProxy(uri, transport=_HttpWithTimeout())
        code, _, value = getattr(master, method)(rospy.get_caller_id(), *arguments)
    except (OSError, xmlrpc.client.Error, http.client.HTTPException, ExpatError, ValueError) as error:
        raise MasterLost(f"The ROS master at {uri} does not answer.") from error
    return value if code == 1 else None


def master_answers() -> bool:
    """Asks, before rospy does: it waits for ever for a master that hangs, as it does with a node's first topic."""
    try:
        ask_master("getPid")
    except MasterLost:
        return False
    return True


def listens(uri: str) -> bool:
    """Returns whether a node listens at its address, `http://host:port/`: the master still lists those that died."""
    listens_timeout_s = 3.0
    try:
        address = urlparse(uri)
        with socket.create_connection((address.hostname, address.port), listens_timeout_s):
            return True
    except (OSError, TypeError, ValueError):  # no listener, no address, no port
        return False


class _HttpWithTimeout(xmlrpc.client.Transport):
    def make_connection(self, host):
        master_timeout_s = 2.0
        connection = super().make_connection(host)
        connection.timeout = master_timeout_s
        return connection
