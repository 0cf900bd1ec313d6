"""The WebSocket to the Leap service, read in the caller's thread: websockets' own client hands each message from a
thread that reads the socket to the caller's, and waits until that has taken it.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections import deque
from urllib.parse import urlencode

from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

OPEN_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 0.5
READ_BYTES = 65536


class LeapSocket(contextlib.AbstractContextManager):
    """An open connection.

    Raises OSError, EOFError, UnicodeError or WebSocketException if nobody opens one within OPEN_TIMEOUT_S. `code`:
    what the service asks clients of other machines for.
    """

    def __init__(self, host: str, port: int, code: str = "") -> None:
        self.ponged = False  # whether the newest ping was answered
        self._messages: deque[str | bytes] = deque()
        self._parts: list[bytes] = []  # of a message that is not complete
        self._is_text = False
        query = f"?{urlencode({'code': code})}" if code else ""
        self._protocol = ClientProtocol(parse_uri(f"ws://{host}:{port}/v6.json{query}"))
        deadline = time.monotonic() + OPEN_TIMEOUT_S
        self._socket = socket.create_connection((host, port), OPEN_TIMEOUT_S)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
            self._protocol.send_request(self._protocol.connect())
            while self._protocol.state is State.CONNECTING and self._protocol.handshake_exc is None:
                self._read(deadline)
            if self._protocol.handshake_exc is not None:
                raise self._protocol.handshake_exc
        except BaseException:
            self._socket.close()
            raise

    def recv(self, timeout: float) -> str | bytes:
        """Returns the next message; raises TimeoutError if none comes within `timeout` [s], ConnectionClosed if the
        service has ended the connection.
        """
        deadline = time.monotonic() + timeout
        while not self._messages:
            self._require_open()
            try:
                self._read(deadline)
            except TimeoutError:
                raise
            except OSError as error:
                raise self._closed() from error
        return self._messages.popleft()

    def send(self, text: str) -> None:
        """Sends a message; raises ConnectionClosed if the service has ended the connection."""
        self._require_open()
        self._protocol.send_text(text.encode())
        self._flush()

    def ping(self) -> None:
        """Sends a ping; `ponged` says whether its answer came. Raises as `send` does."""
        self._require_open()
        self.ponged = False
        self._protocol.send_ping(b"")
        self._flush()

    def __exit__(self, *_exception: object) -> None:
        """Closes the connection in CLOSE_TIMEOUT_S at most."""
        deadline = time.monotonic() + CLOSE_TIMEOUT_S
        with self._socket, contextlib.suppress(OSError):
            if self._protocol.state is State.OPEN:
                self._protocol.send_close(1000)
            while self._protocol.state is not State.CLOSED:
                self._read(deadline)

    def _read(self, deadline: float) -> None:
        """Waits for bytes, and takes the messages in them; raises TimeoutError if none come in time."""
        self._flush()
        rest = deadline - time.monotonic()
        if rest <= 0.0:
            raise TimeoutError
        self._socket.settimeout(rest)
        try:
            data = self._socket.recv(READ_BYTES)
        except socket.timeout:
            raise TimeoutError from None  # the two are one from Python 3.10 on
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if isinstance(event, Frame):
                self._take(event)
        self._flush()

    def _take(self, frame: Frame) -> None:
        if frame.opcode is Opcode.PONG:
            self.ponged = True
        elif frame.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            self._is_text = frame.opcode is Opcode.TEXT if not self._parts else self._is_text
            self._parts.append(frame.data)
            if frame.fin:
                self._messages.append(self._message())

    def _message(self) -> str | bytes:
        """Returns the complete message; a text that is not UTF-8 stays as it is, to be refused."""
        data, self._parts = b"".join(self._parts), []
        with contextlib.suppress(UnicodeDecodeError):
            return data.decode() if self._is_text else data
        return data

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
            else:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)

    def _require_open(self) -> None:
        if self._protocol.state is not State.OPEN:
            raise self._closed()

    def _closed(self) -> ConnectionClosed:
        protocol = self._protocol
        return ConnectionClosed(protocol.close_rcvd, protocol.close_sent, protocol.close_rcvd_then_sent)
