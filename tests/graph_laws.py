"""What rospy does, and the graph in virtual time must do: the same tests run on both."""

from __future__ import annotations

import copy

import pytest
import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger, TriggerResponse

from common import clock


def texts_of(what):
    with pytest.raises(Exception) as caught:
        what()
    return type(caught.value).__name__, str(caught.value)


class Topics:
    """The fixtures are those of the file: `ros`, `wait` as wait_until, and `log` that returns what was logged."""

    @pytest.fixture
    def pair(self, ros, wait):
        """Returns a publisher, and the messages of a subscriber that is connected to it."""

        def make(callback=None, **options):
            came = []
            publisher = rospy.Publisher("numbers", Float64, queue_size=100)
            rospy.Subscriber("numbers", Float64, callback or (lambda message: came.append(message.data)), **options)
            wait(lambda: publisher.get_num_connections() == 1, 10.0, "the connection")
            return publisher, came

        return make

    def test_messages_come_in_order_with_who_sent_them(self, pair, wait):
        came = []
        publisher, _ = pair(lambda message, more: came.append((message, more)), callback_args="more")
        for i in range(50):
            publisher.publish(i)
        wait(lambda: len(came) == 50, 10.0, "all messages")
        assert [(message.data, more) for message, more in came] == [(i, "more") for i in range(50)]
        header = came[0][0]._connection_header
        assert {name: header[name] for name in ("callerid", "topic", "type", "latching")} == {
            "callerid": rospy.get_name(), "topic": "/numbers", "type": "std_msgs/Float64", "latching": "0"
        }  # fmt: skip
        assert len(header["md5sum"]) == 32 and header["message_definition"].startswith("float64 data")

    def test_the_last_of_a_latched_topic_comes_to_late_subscribers(self, ros, wait):
        publisher = rospy.Publisher("words", String, queue_size=1, latch=True)
        for word in ("one", "two"):
            publisher.publish(word)
        first, other = ros.record("words", String), ros.record("words", String)
        wait(lambda: first and other, 10.0, "the latched message")
        publisher.publish("three")
        wait(lambda: len(first) == len(other) == 2, 10.0, "the next message")
        assert [message.data for message in first] == ["two", "three"] == [message.data for message in other]
        assert first[0]._connection_header["latching"] == "1"
        assert rospy.wait_for_message("words", String, timeout=10.0).data == "three"

    def test_a_full_queue_loses_the_oldest(self, pair, wait):
        came, done = [], clock.Event()

        def take(message):
            came.append(message.data)
            done.wait()

        publisher, _ = pair(take, queue_size=1)
        publisher.publish(0.0)
        wait(lambda: came, 10.0, "the first message")
        for i in range(1, 10):
            publisher.publish(i)
        clock.sleep(0.5)
        done.set()
        wait(lambda: came[-1] == 9.0, 10.0, "the last message")
        assert came[0] == 0.0 and came == sorted(came)

    def test_a_callback_that_fails_is_logged_and_the_next_message_comes(self, pair, wait, log):
        came = []

        def take(message):
            came.append(message.data)
            1 / message.data

        publisher, _ = pair(take)
        publisher.publish(0.0)
        publisher.publish(1.0)
        wait(lambda: came == [0.0, 1.0], 10.0, "both messages")
        assert "bad callback: <function" in log() and "ZeroDivisionError: float division by zero" in log()

    def test_what_cannot_be_published_is_refused(self, pair, wait):
        publisher, came = pair()
        publisher.publish(Float64(3.0))
        wait(lambda: came == [3.0], 10.0, "what can be")  # before: rospy sends what it wrote of a bad message, too
        assert texts_of(lambda: publisher.publish("one"))[0] == "ROSSerializationException"
        text = "expected [float64] but got [std_msgs/String]"
        assert texts_of(lambda: publisher.publish(String("one"))) == ("TypeError", text)
        assert texts_of(lambda: publisher.publish(1.0, 2.0)) == (
            "TypeError", "Invalid number of arguments, args should be ['data'] args are(1.0, 2.0)"
        )  # fmt: skip
        publisher.unregister()
        text = "publish() to an unregistered() handle"
        assert texts_of(lambda: publisher.publish(1.0)) == ("ROSException", text)
        publisher.unregister()

    def test_who_unregisters_hears_no_more(self, pair, ros, wait):
        publisher, came = pair()
        other = []
        listener = rospy.Subscriber("numbers", Float64, other.append)
        wait(lambda: listener.get_num_connections() == 1, 10.0, "the connection")
        clock.sleep(0.1)
        publisher.publish(1.0)
        wait(lambda: came and other, 10.0, "the message")
        listener.unregister()
        publisher.publish(2.0)
        wait(lambda: came == [1.0, 2.0], 10.0, "the next message")
        assert len(other) == 1

    def test_who_takes_any_type_gets_bytes(self, ros, wait):
        rospy.Publisher("numbers", Float64, queue_size=1, latch=True).publish(1.0)
        came = ros.record("numbers", rospy.AnyMsg)
        wait(lambda: came, 10.0, "the message")
        assert came[0]._buff == b"\0\0\0\0\0\0\xf0?" and came[0]._connection_header["type"] == "std_msgs/Float64"

    def test_all_subscribers_of_a_node_get_the_type_of_the_first(self, ros, wait):
        came = []
        for kind in (rospy.AnyMsg, Float64):
            rospy.Subscriber("numbers", kind, lambda message: came.append(type(message)))
        rospy.Publisher("numbers", Float64, queue_size=1, latch=True).publish(1.0)
        wait(lambda: len(came) == 2, 10.0, "both messages")
        assert came == [rospy.AnyMsg, rospy.AnyMsg]

    def test_nobody_sends_what_is_waited_for(self, ros):
        text = "timeout exceeded while waiting for message on topic words"
        assert texts_of(lambda: rospy.wait_for_message("words", String, timeout=0.2)) == ("ROSException", text)

    def test_frames_are_broadcast(self, ros, wait):
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        static, moving = tf2_ros.StaticTransformBroadcaster(), tf2_ros.TransformBroadcaster()
        frame = TransformStamped()
        frame.header.frame_id, frame.child_frame_id = "base", "arm"
        frame.transform.rotation.w = frame.transform.translation.x = 1.0
        static.sendTransform(frame)
        frame = copy.deepcopy(frame)  # rospy keeps what is latched, not its bytes
        frame.header.frame_id, frame.child_frame_id = "arm", "hand"

        def found():
            frame.header.stamp = rospy.Time.now()
            moving.sendTransform(frame)
            return buffer.can_transform("base", "hand", rospy.Time())

        wait(found, 10.0, "the frames")
        transform = buffer.lookup_transform("base", "hand", rospy.Time(), rospy.Duration(1.0))
        assert transform.transform.translation.x == 2.0
        with pytest.raises(tf2_ros.TransformException, match="nowhere"):
            buffer.lookup_transform("base", "nowhere", rospy.Time(), rospy.Duration(0.1))
        listener.unregister()
        for broadcaster in (static, moving):  # else they would be those of the next test
            (broadcaster.pub_tf if hasattr(broadcaster, "pub_tf") else broadcaster._pub).unregister()


class Services:
    def test_it_answers_the_caller(self, ros):
        callers = []

        def answer(request):
            callers.append(request._connection_header["callerid"])
            return [not request.data, "done"]

        service = rospy.Service("work", SetBool, answer)
        rospy.wait_for_service("work", 10.0)
        proxy = rospy.ServiceProxy("work", SetBool)
        assert (proxy(True).success, proxy(data=False).success, proxy(False).message) == (False, True, "done")
        assert callers == [rospy.get_name()] * 3
        assert texts_of(lambda: proxy(True, 2)) == (
            "TypeError", "Invalid number of arguments, args should be ['data'] args are(True, 2)"
        )  # fmt: skip
        assert texts_of(lambda: rospy.Service("work", SetBool, answer)) == (
            "ServiceException", "service [/work] already registered"
        )  # fmt: skip
        service.shutdown()
        assert texts_of(lambda: proxy(True)) == ("ServiceException", "service [/work] unavailable")

    def test_what_goes_wrong_is_told_to_the_caller(self, ros, log):
        def outcome(answer):
            service = rospy.Service("work", Trigger, answer)
            try:
                return texts_of(rospy.ServiceProxy("work", Trigger))
            finally:
                service.shutdown()

        def refuse(_):
            raise rospy.ServiceException("not today")

        start = "service [/work] responded with an error: "
        assert outcome(refuse) == ("ServiceException", f"{start}b'service cannot process request: not today'")
        assert "not today" not in log()
        assert outcome(lambda _: 1 // 0) == (
            "ServiceException", f"{start}b'error processing request: integer division or modulo by zero'"
        )  # fmt: skip
        assert "Error processing request: integer division or modulo by zero\n" in log() and "Traceback" in log()
        assert outcome(lambda _: None) == (
            "ServiceException", f"{start}b'service cannot process request: service handler returned None'"
        )  # fmt: skip
        assert outcome(lambda _: TriggerResponse(success="perhaps", message=1))[0] == "ServiceException"

    def test_nobody_offers_what_is_waited_for(self, ros):
        text = "timeout exceeded while waiting for service /work"
        assert texts_of(lambda: rospy.wait_for_service("work", 0.2)) == ("ROSException", text)
        assert texts_of(lambda: rospy.wait_for_service("work", 0.0)) == ("ValueError", "timeout must be non-zero")


class Parameters:
    def test_values_and_namespaces(self, ros):
        assert texts_of(lambda: rospy.get_param("gain")) == ("KeyError", "'gain'")
        assert rospy.get_param("gain", 7) == 7 and not rospy.has_param("gain")
        rospy.set_param("arm", {"gain": 1, "limits": {"low": (1.5, True), "name": "a"}})
        rospy.set_param("arm/limits/high", [])
        assert rospy.get_param("/arm/limits/") == {"low": [1.5, True], "name": "a", "high": []}
        assert rospy.get_param("arm/gain") == 1 and rospy.has_param("arm/limits")
        assert {"/arm/gain", "/arm/limits/low", "/arm/limits/name", "/arm/limits/high"} <= set(rospy.get_param_names())
        rospy.set_param("arm/gain/p", 2)  # a value that becomes a namespace
        assert rospy.get_param("arm/gain") == {"p": 2}
        rospy.set_param("arm", {"gain": 3})
        assert rospy.get_param("arm") == {"gain": 3}
        rospy.delete_param("arm/gain")
        assert rospy.get_param("arm") == {}
        assert texts_of(lambda: rospy.delete_param("arm/gain")) == ("KeyError", "'arm/gain'")
        rospy.set_param("~own", "mine")
        assert rospy.get_param(f"{rospy.get_name()}/own") == rospy.get_param("~own") == "mine"
        rospy.get_param("arm")["gain"] = 4
        assert rospy.get_param("arm") == {}, "what is returned is a copy"
        rospy.delete_param(rospy.get_name())

    @pytest.mark.parametrize("value", [None, 2**31, {1: 2}, {"a": object()}], ids=["None", "int", "key", "object"])
    def test_what_is_no_parameter_is_refused(self, ros, value):
        assert texts_of(lambda: rospy.set_param("bad", value))[0] in ("TypeError", "OverflowError")
        assert not rospy.has_param("bad")

    def test_they_are_searched_upwards(self, ros):
        rospy.set_param("/a", {"b": 1})
        rospy.set_param("~c", 2)
        own = rospy.get_name()
        assert rospy.search_param("a") == "/a" and rospy.search_param("c") == f"{own}/c"
        assert rospy.search_param("a/nothing") == "/a/nothing" and rospy.search_param("nothing") is None
        assert rospy.search_param("/a/b") == "/a/b" and rospy.search_param("/nothing") is None
        rospy.set_param("~a", 3)
        assert rospy.search_param("a") == f"{own}/a"
        rospy.delete_param(own)

    def test_names_are_resolved(self, ros):
        own = rospy.get_name()
        assert [rospy.resolve_name(name) for name in ("a", "a/b", "/a", "~a", "~", "", "/", "a/", "~a/b/", "a//b")] == [
            "/a", "/a/b", "/a", f"{own}/a", f"{own}/", "/", "/", "/a", f"{own}/a/b", "/a/b"
        ]  # fmt: skip
        assert rospy.get_namespace() == "/" and rospy.get_caller_id() == own
        assert [rospy.resolve_name(name, "/left/arm") for name in ("a", "~a", "/a", "")] == [
            "/left/a", "/left/arm/a", "/a", "/left/"
        ]  # fmt: skip


PROGRAM = """
import sys
import rospy
from std_msgs.msg import String
from std_srvs.srv import Empty

rospy.init_node("life")
publisher = rospy.Publisher("words", String, queue_size=1)
service = rospy.Service("work", Empty, lambda _: None)

def attempt(name, what):
    try:
        print(name, what())
    except Exception as error:
        print(name, type(error).__name__, error)

def hook(name):
    def called():
        print("hook", name, rospy.is_shutdown())
        attempt("published in a hook", lambda: publisher.publish("a"))
        if name == "bad":
            raise ValueError("in a hook")
    return called

for name in ("first", "bad", "last"):
    rospy.on_shutdown(hook(name))
print(rospy.myargv(), rospy.get_name(), rospy.resolve_name("words"), rospy.get_param("~number"), publisher.name)
rospy.signal_shutdown("it is enough")
rospy.signal_shutdown("again")
rospy.spin()
print("shut down", rospy.is_shutdown())
attempt("published", lambda: publisher.publish("b"))
attempt("called", lambda: rospy.ServiceProxy("work", Empty)())
attempt("waited", lambda: rospy.wait_for_message("words", String, 1.0))
attempt("waited", lambda: rospy.wait_for_service("work", 1.0))
sys.exit("good bye")
"""


class Lives:
    """`start` starts a file of Python as a node."""

    def test_a_life(self, ros, start, tmp_path):
        (tmp_path / "life.py").write_text(PROGRAM)
        words = ["one", "__ns:=/left", "__name:=two", "_number:=3", "words:=others", f"__log:={tmp_path / 'x'}"]
        node = start(tmp_path / "life.py", *words)
        assert node.wait(20.0) == 1
        said = node.log_path.read_text().splitlines()
        assert "ValueError: in a hook" in said
        words = ("hook", "published", "shut", "called", "waited", "good", "[")
        first, *others = [line for line in said if line.startswith(words)]
        assert first.endswith("life.py', 'one'] /left/two /left/others 3 /left/others")
        assert others == [
            "hook first False", "published in a hook None", "hook bad False", "published in a hook None",
            "hook last False", "published in a hook None", "shut down True", "published None",
            "called ServiceException service [/left/work] unavailable",
            "waited ROSInterruptException rospy shutdown", "waited ROSInterruptException rospy shutdown", "good bye",
        ]  # fmt: skip

    @pytest.mark.parametrize(
        ("text", "code", "last"),
        [
            ("1 // 0", 1, "ZeroDivisionError: integer division or modulo by zero"),
            ("import sys; sys.exit(3)", 3, ""),
            ("import sys; sys.exit()", 0, ""),
            ("import sys; sys.exit('why')", 1, "why"),
            ("print('done')", 0, "done"),
            ("import rospy; rospy.init_node('a'); rospy.logwarn('careful'); rospy.signal_shutdown('')", 0, "careful"),
            ("import threading as t; a = t.Thread(target=lambda: 1 // 0); a.start(); a.join()", 0,
             "ZeroDivisionError: integer division or modulo by zero"),
        ],
    )  # fmt: skip
    def test_an_end(self, ros, start, tmp_path, text, code, last):
        text = text.replace("import threading as t", "from common import clock as t")
        (tmp_path / "end.py").write_text(text)
        node = start(tmp_path / "end.py")
        assert node.wait(20.0) == code
        said = node.log_path.read_text().splitlines()
        assert (said[-1] if said else "").endswith(last) and bool(said) == bool(last)
        assert any("Traceback" in line for line in said) == ("1 // 0" in text)

    def test_a_second_node_of_a_name_ends_the_first(self, ros, start, tmp_path, wait):
        (tmp_path / "same.py").write_text("import rospy; rospy.init_node('same'); print('there'); rospy.spin()")
        first = start(tmp_path / "same.py")
        wait(lambda: "there" in first.log_path.read_text(), 20.0, "the first")
        second = start(tmp_path / "same.py")
        assert first.wait(20.0) == 0
        text = "shutdown request: [/same] Reason: new node registered with same name"
        assert text in first.log_path.read_text() and text not in second.log_path.read_text()
        wait(lambda: "there" in second.log_path.read_text(), 20.0, "the second")
        assert second.poll() is None
