"""The graph in virtual time: the laws that hold for rospy, too, and what nodes meet that live on it."""

from __future__ import annotations

import runpy
import signal
import sys

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty

import kst.transport
from common.ros.publishing import DirectPublisher
from common.ros.service_calls import ServiceFailed, call
from simulated.graph import Graph
from tests import graph_laws

pytestmark = pytest.mark.ros


@pytest.fixture
def wait(ros):
    return ros.wait_until


@pytest.fixture
def log(ros):
    return lambda: ros.here.log


@pytest.fixture
def start(ros):
    def run(file, *words):
        return ros.start(file.name, lambda: runpy.run_path(str(file), run_name="__main__"), str(file), *words)

    return run


class TestTopics(graph_laws.Topics):
    pass


class TestServices(graph_laws.Services):
    pass


class TestParameters(graph_laws.Parameters):
    pass


class TestLives(graph_laws.Lives):
    pass


@pytest.fixture
def beats(ros):
    """A node that publishes the time each 0.1 s, and what the test hears."""

    def main():
        rospy.init_node("heart")
        publisher, rate = rospy.Publisher("beat", Float64, queue_size=1), rospy.Rate(10)
        rospy.on_shutdown(lambda: print("bye"))
        rospy.loginfo("it beats")
        while not rospy.is_shutdown():
            publisher.publish(rospy.get_time())
            rate.sleep()

    heart = ros.start("heart.py", main)
    came = ros.record("beat", Float64)
    came.wait(3)
    return heart, came


class TestTheGraph:
    def test_a_rate_is_exact_and_log_lines_have_virtual_time(self, beats):
        heart, came = beats
        gaps = [b.data - a.data for a, b in zip(came, came[1:])]
        assert gaps == pytest.approx([0.1] * len(gaps), abs=1e-6)
        assert heart.log == "[INFO] [1700001000.000000]: it beats\n" or "]: it beats\n" in heart.log
        assert heart.name == "/heart" and came[0]._connection_header["callerid"] == "/heart"

    def test_what_is_sent_before_the_connection_is_lost(self, ros):
        publisher = rospy.Publisher("numbers", Float64, queue_size=10)
        came = ros.record("numbers", Float64)
        publisher.publish(1.0)
        clock.sleep(0.01)
        assert publisher.get_num_connections() == 1
        publisher.publish(2.0)
        clock.sleep(0.002)
        assert [message.data for message in came] == [2.0]

    @pytest.mark.parametrize("size, kept", [(1, [0, 9]), (3, [0, 7, 8, 9]), (None, list(range(10)))])
    def test_a_full_queue_keeps_the_newest(self, ros, size, kept):
        publisher, came = rospy.Publisher("numbers", Float64, queue_size=10), []

        def take(message):
            came.append(message.data)
            clock.sleep(1.0)

        rospy.Subscriber("numbers", Float64, take, queue_size=size)
        clock.sleep(0.01)
        for i in range(10):
            publisher.publish(i)
            clock.sleep(0.01)
        clock.sleep(20.0)
        assert came == kept

    def test_a_topic_of_another_type_is_not_heard(self, ros):
        publisher = rospy.Publisher("numbers", Float64, queue_size=1, latch=True)
        publisher.publish(1.0)
        came = ros.record("numbers", String)
        clock.sleep(1.0)
        assert not came and publisher.get_num_connections() == 0
        text = "Unable to connect to /test: topic types do not match: [std_msgs/String] vs. [std_msgs/Float64]"
        assert text in ros.here.log and "[ERROR]" in ros.here.log

    def test_names_of_a_node(self, beats, ros):
        assert ros.names("/heart") == {"publishes": {"/beat"}, "hears": set(), "offers": set()}

    def test_what_is_waited_for_in_vain_takes_exactly_so_long(self, ros):
        begun = clock.monotonic()
        with pytest.raises(pytest.fail.Exception, match="waited 2 s in vain for a wonder"):
            ros.wait_until(lambda: False, 2.0, "a wonder")
        assert clock.monotonic() - begun == pytest.approx(2.0, abs=0.021)
        assert ros.wait_until(lambda: 7, 0.0, "it") == 7
        with pytest.raises(pytest.fail.Exception, match="has not ended within 1"):
            ros.start("sleeper", lambda: clock.sleep(9.0)).wait(1.0)

    def test_the_test_keeps_its_own_output_and_arguments(self, beats, ros, capsys):
        print("mine")
        ros.start("other", lambda: print(sys.argv), "other", "x").wait(1.0)
        with ros.scheduler.in_group(beats[0].group):
            assert sys.argv == ["heart.py"] or sys.argv == []
            print("the heart's")
        print("mine, too")
        assert capsys.readouterr().out == "mine\nmine, too\n"
        assert "the heart's\n" in beats[0].log and ros.nodes[-1].log == "['other', 'x']\n"
        assert sys.argv[0] != "other"

    def test_a_publisher_that_writes_directly_is_one(self, ros):
        publisher = DirectPublisher("numbers", Float64, queue_size=1, latch=True)
        publisher.publish(1.0)
        came = ros.record("numbers", Float64)
        came.wait(1, 0.1)
        publisher.publish(data=2.0)
        came.wait(2, 0.1)


class TestSignals:
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_an_interrupted_node_shuts_down(self, beats, number):
        heart, came = beats
        heart.send_signal(number)
        assert heart.poll() is None and heart.wait(0.2) == 0 == heart.poll()
        assert heart.log.endswith("bye\n")
        count = len(came)
        clock.sleep(1.0)
        assert len(came) == count
        heart.send_signal(number)

    def test_a_killed_node_says_nothing(self, beats, ros):
        heart, came = beats
        heart.send_signal(signal.SIGKILL)
        assert heart.returncode == -9 and "bye" not in heart.log and ros.names("/heart")["publishes"] == set()
        count = len(came)
        clock.sleep(1.0)
        assert len(came) == count and heart.wait(0.0) == -9

    @pytest.mark.parametrize("end", [signal.SIGCONT, signal.SIGKILL])
    def test_a_suspended_node_stands_still(self, beats, end):
        heart, came = beats
        heart.send_signal(signal.SIGSTOP)
        clock.sleep(0.05)
        count = len(came)
        heart.send_signal(signal.SIGINT)
        clock.sleep(5.0)
        assert len(came) == count and heart.poll() is None
        heart.send_signal(end)
        assert heart.wait(0.2) == (0 if end == signal.SIGCONT else -9)
        assert ("bye" in heart.log) == (end == signal.SIGCONT)


class TestServicesOfNodes:
    @pytest.fixture
    def slow(self, ros):
        """A node that takes 1 s for an answer."""

        def main():
            rospy.init_node("slow")
            rospy.Service("work", Empty, lambda _: clock.sleep(1.0) or [])
            rospy.spin()

        slow = ros.start("slow.py", main)
        ros.wait_until(lambda: "/work" in ros.services, 1.0, "the service")
        return slow

    @staticmethod
    def call(timeout=2.0):
        begun = clock.monotonic()
        try:
            call("work", Empty, timeout=timeout)
            said = ""
        except ServiceFailed as error:
            said = str(error)
        return said, clock.monotonic() - begun

    def test_one_that_stands_still_never_gets_the_request(self, slow):
        slow.send_signal(signal.SIGSTOP)
        said, lasted = self.call()
        assert "did not answer within 2 s: nothing was requested" in said and lasted == 2.0
        said, lasted = self.call(9.0)
        assert "did not answer the handshake within 5 s" in said and lasted == pytest.approx(5.0, abs=0.01)

    @pytest.mark.parametrize("number, lasts", [(signal.SIGKILL, 0.5), (signal.SIGINT, 1.0)])
    def test_one_that_ends_meanwhile(self, slow, ros, number, lasts):
        def end():
            clock.sleep(0.5)
            slow.send_signal(number)

        clock.Thread(target=end).start()
        said, lasted = self.call()
        assert "failed: " in said and lasted == pytest.approx(0.5, abs=0.01)
        assert "is not offered: nobody offers it" in self.call()[0]


def scene(seed):
    """Two nodes that talk to each other and stop; returns the turns."""
    with Graph(seed, trace=True) as graph:
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        def server():
            rospy.init_node("server")
            rospy.Service("ask", Trigger, lambda _: [True, "yes"])
            rospy.spin()

        def client():
            rospy.init_node("client", anonymous=True)
            rospy.wait_for_service("ask")
            publisher = rospy.Publisher("answers", String, queue_size=5, latch=True)
            for _ in range(3):
                publisher.publish(rospy.ServiceProxy("ask", Trigger)().message)
                rospy.sleep(0.1)

        answers = graph.record("answers", String)
        first = graph.start("server", server)
        assert graph.start("client", client).wait(5.0) == 0
        answers.wait(1)
        first.send_signal(signal.SIGINT)
        assert first.wait(1.0) == 0
    return graph.scheduler.trace


def test_a_seed_makes_one_run_and_others_make_others():
    assert scene(1) == scene(1)
    assert len({tuple(scene(seed)) for seed in range(6)}) == 6


def test_the_ends_of_a_killed_node_reach_nobody(ros):
    listener = kst.transport.socket.socket()
    listener.bind(("127.0.0.1", 0))
    listener.listen()

    def main():
        connection = kst.transport.socket.create_connection(listener.getsockname(), 1.0)
        try:
            clock.sleep(100.0)
        finally:
            connection.send(b"stop")

    node = ros.start("node", main)
    far, _ = listener.accept()
    node.send_signal(signal.SIGKILL)
    far.settimeout(1.0)
    assert far.recv(10) == b"" and "Traceback" not in node.log
