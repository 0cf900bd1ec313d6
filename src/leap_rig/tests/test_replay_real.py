"""The program replay.py with a Leap service that a client reaches."""

import json
import re
import time

import pytest
from recordings import START, stored, write_recording

from leap_motion.client import LeapClient

pytestmark = pytest.mark.ros


def test_a_client_hears_what_was_recorded(ros, tmp_path, wait_until):
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    from leap_motion.msg import RawFrame

    texts = [f'{{"id":{i},  "timestamp":{9000 * i},"hands":[],"pointables":[],"x":"é"}}' for i in range(100)]
    status = DiagnosticStatus(name="leap_motion", values=[KeyValue("service_version", "2.3.1")])
    messages = [stored("/diagnostics", DiagnosticArray(status=[status]), 0.0)]
    for i, text in enumerate(texts):
        frame = RawFrame(rospy.Time(0, START + 10**7 * i), text)
        messages.append(stored("/leap_motion/raw_frames", frame, 0.01 * i + 0.001))
    folder = write_recording(tmp_path / "run", messages, name="run")
    program = ros.run("leap_rig", "replay.py", str(folder), "--tracker", "--port", "0")
    port = int(wait_until(lambda: re.search(r"127.0.0.1:(\d+)", program.log_path.read_text()), 20.0, "a port")[1])
    heard = []
    client = LeapClient(port=port, clock=time.monotonic, tap=lambda text, stamp: heard.append(text))
    try:
        assert program.wait(20.0) == 0, program.log_path.read_text()
        wait_until(lambda: any("hands" in text for text in list(heard)), 20.0, "a frame")
        assert client.status.service == "2.3.1"
    finally:
        client.close()
    numbers = [json.loads(text)["id"] for text in heard if "hands" in text]
    assert numbers and numbers == sorted(set(numbers))
    assert {text for text in heard if "hands" in text} <= set(texts)
