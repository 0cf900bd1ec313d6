"""Service calls with a time-out."""

from __future__ import annotations

import threading

import pytest

from common.errors import DeviceError

pytestmark = pytest.mark.ros


def test_a_call_answers_fails_or_ends_in_time(ros):
    import rospy
    from std_srvs.srv import SetBool, SetBoolResponse

    from common.ros.calls import call

    go_on = threading.Event()

    def answer(request):
        if not request.data:
            go_on.wait(30.0)
        return SetBoolResponse(request.data, "so it is")

    service = rospy.Service("answers", SetBool, answer)
    try:
        assert call("answers", SetBool, True, timeout=30.0).message == "so it is"
        with pytest.raises(DeviceError, match=r"the service answers did not answer within 0\.2 s"):
            call("answers", SetBool, False, timeout=0.2)
        with pytest.raises(DeviceError, match="the service nobody failed: .*"):
            call("nobody", SetBool, True, timeout=30.0)
    finally:
        go_on.set()
        service.shutdown()
