"""Publishing at the rate of the tracking frames."""

from __future__ import annotations

import socket
from collections import deque

import rospy
from rospy.exceptions import TransportTerminated


class DirectPublisher(rospy.Publisher):
    """A publisher that writes to its subscribers in the caller's thread and never waits for them. rospy's own hands
    each message to one more thread per subscriber, and gives up its turn on the processor each time. While a subscriber
    does not read, its newest `queue_size` messages wait, and the next `publish` sends them; so for topics that are
    published all the time, or whose few messages fit into a socket's buffer."""

    def __init__(self, name: str, kind: type[rospy.Message], queue_size: int, latch: bool = False) -> None:
        super().__init__(name, kind, tcp_nodelay=True, queue_size=queue_size, latch=latch)
        add = self.impl.add_connection

        def add_connection(connection) -> bool:
            connection.write_data = _Outbox(connection, queue_size).write
            return add(connection)

        self.impl.set_queue_size(None)  # with one, rospy adds the thread
        self.impl.add_connection = add_connection
        for connection in self.impl.connections:  # of subscribers that were faster
            # Another publisher of this topic in this process may have sent half a message.
            if not isinstance(getattr(connection.write_data, "__self__", None), _Outbox):
                connection.write_data = _Outbox(connection, queue_size).write


class _Outbox:
    """The messages that one subscriber has not taken yet."""

    def __init__(self, connection, size: int) -> None:
        self._connection = connection
        self._size = size
        self._waiting: deque[bytes] = deque()
        self._begun = False  # whether a part of the first one is sent
        if connection.socket is not None:
            connection.socket.settimeout(None)  # with rospy's default of 60 s, Python would wait despite MSG_DONTWAIT

    def write(self, data: bytes) -> bool:
        """Sends as much as the subscriber takes; called under the lock of the topic. Raises OSError or
        TransportTerminated if the connection is closed."""
        connection, waiting = self._connection, self._waiting
        if connection.done or connection.socket is None:
            raise TransportTerminated("the connection is closed")
        if len(waiting) - self._begun >= self._size:
            del waiting[int(self._begun)]
        waiting.append(data)
        while waiting:
            try:
                sent = connection.socket.send(waiting[0], socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            connection.stat_bytes += sent
            self._begun = sent < len(waiting[0])
            if self._begun:
                waiting[0] = waiting[0][sent:]
            else:
                waiting.popleft()
                connection.stat_num_msg += 1
        return True
