"""Direct publishing: nobody waits for a subscriber, and what one gets is whole messages."""

import contextlib
import random
import socket
import struct
from types import SimpleNamespace

import pytest

pytest.importorskip("rig_msgs.srv")
import rospy
from rospy.exceptions import TransportTerminated
from std_msgs.msg import UInt32

from common.ros.publishing import DirectPublisher, _Outbox

pytestmark = pytest.mark.ros


def connection_of(subscriber_buffer=4096):
    """A connection as rospy has it, and the subscriber's end of it."""
    sender, receiver = socket.socketpair()
    for end, option in ((sender, socket.SO_SNDBUF), (receiver, socket.SO_RCVBUF)):
        end.setsockopt(socket.SOL_SOCKET, option, subscriber_buffer)
    sender.settimeout(1.0)  # rospy sets one for all sockets of a node
    return SimpleNamespace(socket=sender, done=False, stat_bytes=0, stat_num_msg=0), receiver


def whole_messages(data):
    """The numbers in the messages of the bytes; fails if they are torn."""
    numbers = []
    while data:
        size, number = struct.unpack_from("<II", data)
        assert data[8 : 4 + size] == bytes([number % 251]) * (size - 4)
        numbers.append(number)
        data = data[4 + size :]
    return numbers


def message(number, size):
    return struct.pack("<II", size + 4, number) + bytes([number % 251]) * size


@pytest.mark.parametrize("queue_size", [1, 3])
@pytest.mark.parametrize("seed", range(5))
def test_a_subscriber_that_pauses_gets_whole_messages_in_order_and_the_newest(queue_size, seed):
    rng = random.Random(seed)
    connection, receiver = connection_of()
    outbox, data, newest = _Outbox(connection, queue_size), b"", 0
    for newest in range(1, 400):
        assert outbox.write(message(newest, rng.choice([10, 700, 20000])))
        assert len(outbox._waiting) <= queue_size + 1
        if rng.random() < 0.3:
            data += receiver.recv(rng.choice([100, 5000, 100000]))
    receiver.setblocking(False)
    while len(outbox._waiting) > 0:
        with contextlib.suppress(BlockingIOError):
            data += receiver.recv(10**6)
        waiting = len(outbox._waiting)
        outbox.write(message(newest := newest + 1, 10))
        assert len(outbox._waiting) <= max(waiting, queue_size) + 1
    data += receiver.recv(10**6)
    numbers = whole_messages(data)
    assert numbers == sorted(set(numbers))
    assert numbers[-queue_size:] == list(range(newest - queue_size + 1, newest + 1))
    assert connection.stat_num_msg == len(numbers) < newest
    assert connection.stat_bytes == len(data)


def test_a_closed_connection_is_an_error():
    connection, receiver = connection_of()
    outbox = _Outbox(connection, 1)
    receiver.close()
    with pytest.raises(OSError):
        outbox.write(message(1, 10))
    connection.done = True
    with pytest.raises(TransportTerminated):
        outbox.write(message(2, 10))


@pytest.mark.real
def test_messages_reach_subscribers_that_come_early_and_late(ros, wait_until):
    heard = ros.record("direct", UInt32)
    publisher = DirectPublisher("direct", UInt32, queue_size=1)

    def published():
        publisher.publish(UInt32(7))
        return len(heard) > 3

    wait_until(published, 10.0, "messages")
    late = []
    subscriber = rospy.Subscriber("direct", UInt32, late.append)
    wait_until(lambda: published() and late, 10.0, "messages at the second subscriber")
    subscriber.unregister()
    publisher.unregister()


def test_a_second_publisher_of_a_topic_ends_the_messages_that_the_first_has_begun(monkeypatch):
    connection, receiver = connection_of()
    connection.write_data = None
    impl = SimpleNamespace(connections=[connection], add_connection=bool, set_queue_size=lambda _: None)
    monkeypatch.setattr(rospy.Publisher, "__init__", lambda self, *_, **__: setattr(self, "impl", impl))
    monkeypatch.setattr(rospy.Publisher, "__del__", lambda self: None, raising=False)
    data = b""
    publishers = [DirectPublisher("tf", rospy.AnyMsg, queue_size=10)]
    connection.write_data(message(1, 200_000))
    publishers.append(DirectPublisher("tf", rospy.AnyMsg, queue_size=10))
    receiver.setblocking(False)
    for number in range(2, 200):
        connection.write_data(message(number, 10))
        with contextlib.suppress(BlockingIOError):
            data += receiver.recv(10**6)
    assert whole_messages(data)[0] == 1
