"""The end of a demo whose controller does not answer any more."""

from __future__ import annotations

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy

from kuka_msgs.srv import exitApp
from leap_rig.ros import demo

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(("hangs", "seconds"), [(True, 60.0), (False, 0.0)])
def test_a_controller_that_hangs_or_is_gone_holds_the_demo_for_a_limited_time(virtual_graph, hangs, seconds):
    called, deaths = [], demo.Deaths()
    if hangs:
        rospy.Service("kuka/exit_app", exitApp, lambda _: called.append(True) or clock.sleep(1e3))
    begun = clock.monotonic()
    demo.end_in_order(deaths)
    assert clock.monotonic() - begun == pytest.approx(seconds, abs=0.2)
    assert called == [True] * hangs
    assert len(deaths.sentences) == 1 and "did not accept the request to exit" in deaths.sentences[0]


def test_a_controller_that_accepts_and_does_not_end_is_named(virtual_graph):
    deaths = demo.Deaths()
    rospy.Service("kuka/exit_app", exitApp, lambda _: (True, "the arm goes"))
    begun = clock.monotonic()
    demo.end_in_order(deaths)
    assert clock.monotonic() - begun == pytest.approx(60.0, abs=0.2)
    assert deaths.sentences == ["kuka_real_time_node did not end within 60 s after exit_app"]


@pytest.mark.parametrize("namespace", ["", "lab1", "/lab1/b/"])
def test_all_of_several_controllers_are_asked_to_exit(virtual_graph, monkeypatch, namespace):
    """Also where roslaunch names the processes in the demo's namespace (ROS_NAMESPACE)."""
    monkeypatch.setenv("ROS_NAMESPACE", namespace)
    deaths = demo.Deaths()

    def answer(_):
        deaths.process_died(f"{namespace.strip('/')}/right/kuka_real_time_node-3".strip("/"), 0)
        return True, "the arm goes"

    rospy.Service("right/kuka/exit_app", exitApp, answer)
    demo.end_in_order(deaths, ("left", "right"))
    (fault,) = deaths.sentences
    assert fault.startswith("left/kuka_real_time_node did not accept the request to exit")
