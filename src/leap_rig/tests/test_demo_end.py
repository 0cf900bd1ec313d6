"""The end of a demo whose controller does not answer any more."""

from __future__ import annotations

import threading

import pytest

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("hangs", [True, False])
def test_a_controller_that_hangs_or_is_gone_holds_the_demo_for_a_limited_time(ros, monkeypatch, wait_until, hangs):
    import rospy

    from kuka_msgs.srv import exitApp
    from leap_rig.ros import demo

    monkeypatch.setattr(demo, "EXIT_TIMEOUT_S", 3.0 if hangs else 0.5)  # in which even a busy one is called
    resume, called, deaths = threading.Event(), threading.Event(), demo.Deaths()

    def answer(_):
        called.set()
        resume.wait(60.0)

    service = rospy.Service("kuka/exit_app", exitApp, answer) if hangs else None
    ended = threading.Thread(target=demo.end_in_order, args=(deaths,), daemon=True)
    try:
        ended.start()
        wait_until(lambda: not ended.is_alive(), 30.0, "the demo to go on without the controller's answer")
        assert called.is_set() == hangs
        assert len(deaths.sentences) == 1 and "did not accept the request to exit" in deaths.sentences[0]
    finally:
        resume.set()
        if service is not None:
            service.shutdown()


def test_all_of_several_controllers_are_asked_to_exit(ros, monkeypatch):
    import rospy

    from kuka_msgs.srv import exitApp
    from leap_rig.ros import demo

    monkeypatch.setattr(demo, "EXIT_TIMEOUT_S", 5.0)
    deaths = demo.Deaths()

    def answer(_):
        deaths.process_died("right/kuka_real_time_node-3", 0)
        return True, "the arm goes"

    service = rospy.Service("right/kuka/exit_app", exitApp, answer)
    try:
        demo.end_in_order(deaths, ("left", "right"))
    finally:
        service.shutdown()
    (fault,) = deaths.sentences
    assert fault.startswith("left/kuka_real_time_node did not accept the request to exit")
