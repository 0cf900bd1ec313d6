"""Service calls that return in time, in virtual time."""

from __future__ import annotations

import signal

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from std_srvs.srv import SetBool, SetBoolResponse

from common.ros.service_calls import ServiceAbsent, ServiceClient, ServiceFailed

pytestmark = pytest.mark.ros

DELAY_S = 0.005  # of a call


@pytest.fixture
def offer(ros):
    """A service, which answers with what its handler returns, in a node of its own; the requests, and the node."""

    def start(name, handler=lambda: None):
        requests = []

        def answer(request):
            requests.append(request.data)
            handler()
            return SetBoolResponse(request.data, "so it is")

        def main():
            rospy.Service(name, SetBool, answer)
            rospy.spin()

        return requests, ros.start(name, main)

    return start


@pytest.fixture
def client():
    return ServiceClient("switch", SetBool)


@pytest.fixture
def failure(client):
    """How a call fails, and after which time [s]."""

    def call(value, **times):
        begun = clock.monotonic()
        with pytest.raises(ServiceFailed) as caught:
            client(value, **times)
        return caught.value, clock.monotonic() - begun

    return call


def test_a_call_answers_or_is_given_up_in_time_and_the_next_one_waits_for_its_end(offer, client, failure):
    requests, _ = offer("switch", lambda: clock.sleep(0.0 if len(requests) == 1 else 3.0))
    clock.sleep(0.1)
    begun = clock.monotonic()
    assert client(True, timeout=0.5).message == "so it is" and clock.monotonic() - begun <= DELAY_S
    error, after = failure(False, timeout=0.5)
    assert after == pytest.approx(0.5) and (error.service, error.sent) == ("switch", True)
    assert str(error) == "the service switch did not answer within 0.5 s: it may still execute the request"
    error, after = failure(True, timeout=0.5)
    assert after == pytest.approx(0.5) and not error.sent and "still does not answer" in str(error)
    assert requests == [True, False]
    assert client(True, timeout=6.0).success


def test_a_service_that_fails_or_is_absent(offer, failure):
    def fail():
        raise ValueError("no arm")

    for wait in (0.0, 0.5):
        error, after = failure(True, timeout=30.0, wait=wait)
        assert type(error) is ServiceAbsent and not error.sent and after == pytest.approx(wait, abs=0.11)
    _, node = offer("switch", fail)
    clock.sleep(0.1)
    error, after = failure(True, timeout=30.0)
    assert "no arm" in str(error) and error.sent and after <= DELAY_S
    node.send_signal(signal.SIGINT)
    node.wait(1.0)
    error, _ = failure(True, timeout=30.0)
    assert type(error) is ServiceAbsent


def test_a_service_that_comes_later_is_waited_for(offer, client):
    begun = clock.monotonic()
    clock.Timer(0.5, offer, ("switch",)).start()
    assert client(True, timeout=1.0, wait=1.0).success
    assert clock.monotonic() - begun == pytest.approx(0.55, abs=0.06)


def test_a_node_that_hangs_never_executes_a_call_that_was_given_up(offer, client, failure):
    requests, node = offer("switch")
    clock.sleep(0.1)
    node.send_signal(signal.SIGSTOP)
    error, after = failure(True, timeout=0.5)
    assert not error.sent and after == pytest.approx(0.5)
    node.send_signal(signal.SIGCONT)
    clock.sleep(10.0)
    assert requests == []
    assert client(False, timeout=0.5).message == "so it is" and requests == [False]
