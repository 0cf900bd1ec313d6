"""The hand's way from the text on the WebSocket to the two commands, each step alone. Needs the built messages."""

from __future__ import annotations

import gzip
import io
import itertools

import numpy as np
import rospy
import yaml

from bench.measure import SHARED_DATA, SRC, Row, row, timed
from common.config import parse
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import Rig
from leap_hand import teleop as hand_teleop
from leap_hand.config import HandConfig
from leap_kuka import teleop as arm_teleop
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.teleop_result import StreamState
from leap_motion.codec import read_message
from leap_motion.frames import LeapFrame, TrackingFrame
from leap_motion.msg import Human
from leap_motion.plausibility import HandBounds, PlausibleHands
from leap_motion.ros.human import FrameMessage
from leap_motion.ros.tracking import ReceivedHuman, ReceivedPalms
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

RECORDINGS = ("rollAndPitchWithEntry", "grab", "three-claps")
CLOCK_S = 1.7e9
PERIOD_S = 1.0 / 115.3


def rows(quick: bool) -> list[Row]:
    """Returns the time of each step for frames of the simulated service, of the codec also for recorded ones."""
    count = 60 if quick else 3000
    table = []
    recorded = recorded_texts()[:count]
    if recorded:
        times, _ = timed(read_message, [(text,) for text in recorded])
        table.append(row("leap codec, recorded frames", times, "us", f"{_size(recorded)}, early field set"))
    else:
        table.append(Row("leap codec, recorded frames", None, None, "us", "the recordings are not on this machine"))
    texts = simulated_texts(count)
    times, frames = timed(read_message, [(text,) for text in texts])
    table.append(row("leap codec, simulated frames", times, "us", f"{_size(texts)}, one hand"))
    plausible = PlausibleHands(HandBounds())
    times, _ = timed(plausible.step, [(frame, i * PERIOD_S) for i, frame in enumerate(frames)])
    table.append(row("leap: is the hand plausible", times, "us", "one hand, five fingers"))

    stamps = [rospy.Time.from_sec(CLOCK_S + i * PERIOD_S) for i in range(count)]
    times, packed = timed(_serialised, zip(frames, stamps))
    table.append(row("Human: from the frame to bytes", times, "us", f"{len(packed[-1])} bytes; one hand, five fingers"))
    times, _ = timed(lambda data: Human().deserialize(data), [(data,) for data in packed])
    table.append(row("Human: read by genpy", times, "us", "once in each other node that listens"))

    arm, hand = _arm_teleop(), hand_teleop.HandTeleop(_config(HandConfig, "leap_hand", "leap_hand", "leap_hand"), True)
    times, results = timed(lambda d, s: arm.step(_frame(ReceivedPalms, d, s), s.to_sec()), zip(packed, stamps))
    running = sum(result.state == StreamState.RUNNING for result in results)
    table.append(row("leap_kuka: Human to desired tool", times, "us", f"the stream runs in {running} of them"))
    times, results = timed(lambda d, s: hand.step(_frame(ReceivedHuman, d, s), s.to_sec()), zip(packed, stamps))
    following = sum(result is not None and result.state == hand_teleop.GripperState.FOLLOWING for result in results)
    table.append(row("leap_hand: Human to command", times, "us", f"a hand is followed in {following} of them"))
    return table


def recorded_texts() -> list[str]:
    """Returns the recorded frames with a hand; none where there are no recordings."""
    texts = []
    for path in (SHARED_DATA / "leap" / f"{name}.jsonl.gz" for name in RECORDINGS):
        if path.is_file():
            with gzip.open(path, "rt", encoding="utf-8") as file:
                texts += [line for line in file if '"hands":[]' not in line.replace(" ", "")]
    return texts


def simulated_texts(count: int) -> list[str]:
    """Returns frames of the simulated service with a hand that draws circles."""
    playback = Playback(ScriptedOperator(Script()))
    texts = (playback.next().text for _ in itertools.count())
    return list(itertools.islice((text for text in texts if '"hands":[]' not in text), count))


def _size(texts: list[str]) -> str:
    return f"{np.median([len(text) for text in texts]) / 1e3:.1f} kB in the median"


def _serialised(frame: LeapFrame, stamp: rospy.Time) -> bytes:
    buffer = io.BytesIO()
    FrameMessage(frame, stamp).serialize(buffer)
    return buffer.getvalue()


def _frame(kind: type[ReceivedHuman], data: bytes, now: rospy.Time) -> TrackingFrame:
    return kind().deserialize(data).frame(now)


def _arm_teleop() -> arm_teleop.ArmTeleop:
    kuka = _config(RealTimeConfig, "kuka_control", "kuka_params_rt", "kuka")
    values = {**vars(kuka), "ws_center": Rig.of(kuka).home.centre}
    arm = parse(ArmPlacement, values, "kuka/", others=values)
    return arm_teleop.ArmTeleop(_config(LeapConfig, "leap_kuka", "leap_params", "leap"), arm)


def _config(schema, package: str, file: str, prefix: str):
    values = yaml.safe_load((SRC / package / "config" / f"{file}.yaml").read_text())
    return parse(schema, values, f"{prefix}/")
