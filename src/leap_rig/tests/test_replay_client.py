"""The program replay.py as a tracker: what a client of its Leap service hears."""

import json
import re

import pytest
from recordings import START, stored, write_recording

from common import clock
from leap_motion.client import LeapClient

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from leap_motion.msg import RawFrame

pytestmark = pytest.mark.ros


def test_a_client_hears_what_was_recorded(virtual_graph, tmp_path):
    texts = [f'{{"id":{i},  "timestamp":{9000 * i},"hands":[],"pointables":[],"x":"é"}}' for i in range(100)]
    status = DiagnosticStatus(name="leap_motion", values=[KeyValue("service_version", "2.3.1")])
    messages = [stored("/diagnostics", DiagnosticArray(status=[status]), 0.0)]
    for i, text in enumerate(texts):
        frame = RawFrame(rospy.Time(0, START + 10**7 * i), text)
        messages.append(stored("/leap_motion/raw_frames", frame, 0.01 * i + 0.001))
    folder = write_recording(tmp_path / "run", messages, name="run")
    program = virtual_graph.run("leap_rig", "replay.py", str(folder), "--tracker", "--port", "0")
    port = int(virtual_graph.wait_until(lambda: re.search(r"127.0.0.1:(\d+)", program.log), 5.0, "a port")[1])
    heard = []
    client = LeapClient(port=port, runtime=clock, tap=lambda text, stamp: heard.append(text))
    assert program.wait(20.0) == 0, program.log
    clock.sleep(1.0)
    assert client.status.service == "2.3.1"
    client.close()
    frames = [text for text in heard if "hands" in text]
    assert frames == texts, [json.loads(text)["id"] for text in frames]
