"""Answers LeRobot's plug-ins on a socket of this machine, a file that its owner alone may open."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from common import clock
from common.errors import DeviceError, RigError
from leap_rig.lerobot.wire import LerobotWireFault, packed, unpacked

IDLE_S, MESSAGE_S = 600.0, 5.0  # before a message, and within one
MOST_CLIENTS = 4


class LerobotServer:
    """Gives each request to `answer`, with the number of its connection, from 1, later ones greater; a RigError of it,
    or of the request, is answered as `fault`, a sentence. `left` gets the number of a connection that has ended."""

    def __init__(
        self,
        path: Path,
        answer: Callable[[Mapping[str, Any], int], tuple[Mapping[str, Any], Mapping[str, bytes]]],
        left: Callable[[int], object] = lambda number: None,
    ) -> None:
        self._path, self._answer, self._left = path, answer, left
        self._socket = _listening(path)
        self._lock, self._clients, self._numbers = clock.Lock(), 0, itertools.count(1)
        self._thread = clock.Thread(target=self._accept, name="lerobot", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the server and removes its file."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        with contextlib.suppress(FileNotFoundError):
            self._path.unlink()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return  # closed
            with self._lock:
                self._clients += 1
                full = self._clients > MOST_CLIENTS
            if full:
                self._leave(connection)
                continue
            clock.Thread(
                target=self._serve, args=(connection, next(self._numbers)), name="lerobot client", daemon=True
            ).start()

    def _serve(self, connection: socket.socket, number: int) -> None:
        try:
            while self._exchange(connection, number):
                pass
        except OSError:
            pass  # it has gone, or says nothing
        finally:
            self._left(number)
            self._leave(connection)

    def _leave(self, connection: socket.socket) -> None:
        connection.close()
        with self._lock:
            self._clients -= 1

    def _exchange(self, connection: socket.socket, number: int) -> bool:
        """Answers one request; returns whether another one can follow."""
        connection.settimeout(IDLE_S)
        if not connection.recv(1, socket.MSG_PEEK):
            return False
        connection.settimeout(MESSAGE_S)
        goes_on = True
        try:
            request = unpacked(lambda count: _exactly(connection, count))[0]
            said, images = self._answer(request, number)
        except LerobotWireFault as error:
            said, images, goes_on = {"fault": str(error)}, {}, False
        except RigError as error:
            said, images = {"fault": str(error)}, {}
        connection.sendall(packed(said, images))
        return goes_on


def _listening(path: Path) -> socket.socket:
    """Returns a socket that listens at a path; raises DeviceError if another server does, or the path cannot be."""
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_socket():
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
                other.settimeout(MESSAGE_S)
                if other.connect_ex(str(path)) == 0:
                    raise DeviceError(f"Another server listens on {path}; end it first, or choose another --socket.")
            path.unlink()  # of one that was killed
        before = os.umask(0o177)
        try:
            server.bind(str(path))
        finally:
            os.umask(before)
        server.listen(MOST_CLIENTS)
        server.settimeout(None)  # whatever a node gives its sockets
    except OSError as error:
        server.close()
        raise DeviceError(f"{path} cannot be listened on: {error.strerror or error}.") from error
    except DeviceError:
        server.close()
        raise
    return server


def _exactly(connection: socket.socket, count: int) -> bytes:
    """Returns so many bytes; raises ConnectionError if the other side ends before."""
    data = bytearray()
    while len(data) < count:
        part = connection.recv(min(count - len(data), 2**16))
        if not part:
            raise ConnectionError("The other side ended within a message.")
        data += part
    return bytes(data)
