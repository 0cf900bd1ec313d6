"""The hand as one state machine: packets and requests go in, packets to send and readings come out. Pure: each call
takes the time `now` [s, monotonic] and returns a HandUpdate. Angles are joint angles [rad] of f1, f2, f3, preshape;
0 is open. A target goes only to a hand that sends packets, has torque and whose angles fit its calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from reflex.calibration import FingerCalibration, FingerZeros, TactileOffsets, mean_offsets, open_positions, zeros_here
from reflex.codec import IDLE, POSITION, StatePacket, encode_mode
from reflex.conversions import servo_fault
from reflex.link import PacketArrival, PacketFilter
from reflex.motion import HandNote, MotorGoals
from reflex.reading import UNLOADED, HandReading, measure
from reflex.settings import HandSettings, setting_fault

CALIBRATING = "The fingers are being calibrated."


class HandStatus(Enum):
    """State of the hand."""

    WAITING = "waiting"
    SILENT = "silent"
    TORQUE_OFF = "torque off"
    CALIBRATING = "calibrating"
    CHANGING_SPEED = "changing speed"
    READY = "ready"


class HandRequest(Enum):
    """What a program asks for."""

    COMMAND = "command"
    RAW_COMMAND = "command_raw"
    SPEED = "set_speed"
    CALIBRATE_FINGERS = "calibrate_fingers"
    CALIBRATE_TACTILE = "calibrate_tactile"
    ZERO_POSE = "zero_pose"


_R = HandRequest
REFUSALS: tuple[tuple[HandStatus, tuple[HandRequest, ...], str], ...] = (
    (HandStatus.SILENT, (_R.COMMAND, _R.RAW_COMMAND, _R.SPEED), ""),  # the link says more
    (
        HandStatus.TORQUE_OFF,
        (_R.COMMAND, _R.RAW_COMMAND, _R.CALIBRATE_FINGERS),
        "Torque is off; set_speed switches it on again.",
    ),
    (HandStatus.CALIBRATING, (_R.RAW_COMMAND, _R.ZERO_POSE), CALIBRATING),
    (HandStatus.CALIBRATING, (_R.SPEED,), "The fingers are being calibrated; set the speed afterwards."),
)
"""In which state a request is refused, and why; of several rows the first. All else is followed: a command during a
calibration after its end, and what needs a packet with the next one."""


class HandRecovery(Enum):
    """After what the hand is there again: level and sentence of the note, and whether its servos may have lost
    torque, speed and turn. Each ends a calibration."""

    CONNECTED = "info", "The hand is connected.", True
    RESUMED = "info", "The hand is heard again.", False
    RESTARTED = "warning", "The hand was switched off and on: calibrate its fingers before they are used.", True
    SERVOS_ANSWER = "warning", "All servos answer again: calibrate the fingers before they are used.", True

    def __init__(self, level: str, sentence: str, servos_started: bool) -> None:
        self.level = level
        self.sentence = sentence
        self.servos_started = servos_started


RECOVERIES = {
    PacketArrival.FIRST: HandRecovery.CONNECTED,
    PacketArrival.RESUMED: HandRecovery.RESUMED,
    PacketArrival.RESTARTED: HandRecovery.RESTARTED,
}


@dataclass(frozen=True)
class HandUpdate:
    """Result of a packet, a request or the passing of time."""

    send: tuple[bytes, ...] = ()  # packets for the hand, in order
    notes: tuple[HandNote, ...] = ()  # for the log
    refusal: str = ""  # reason why a request was not followed, as a sentence, or empty
    reading: HandReading | None = None  # measurements, when a packet came
    zeros: FingerZeros | None = None  # new zeros of the fingers, to be saved
    offsets: TactileOffsets | None = None  # new zeros of the tactile sensors, to be saved


class HandLogic:
    """State machine of one hand, with its last `reading`; unless the zeros are this hand's own (`calibrated`), it
    refuses commands until it is calibrated."""

    def __init__(self, settings: HandSettings, zeros: FingerZeros, offsets: TactileOffsets, calibrated: bool) -> None:
        self._settings = settings
        self._zeros = zeros
        self._offsets = offsets
        self.calibrated = calibrated
        self._thresholds: tuple[tuple[int, ...], ...] = ((settings.default_contact_threshold,) * 9,) * 3
        self.link = PacketFilter(settings.silence_time)
        self.motion = MotorGoals(settings)
        self._torque = True
        self._speeds: tuple[float, ...] = tuple(settings.default_speed)
        self._calibration: FingerCalibration | None = None
        self._requests: dict[HandRequest, float] = {}
        self._tactile: list[StatePacket] | None = None
        self._waiting_command: tuple[float, ...] | None = None
        self.reading: HandReading | None = None
        self._complaint_time = -math.inf
        self.calibration_outcome = "none yet"
        self.commands = self.refused = 0
        self._clear()

    def state(self, now: float) -> HandStatus:
        if not self.link.alive(now):
            return HandStatus.SILENT if self.link.heard() else HandStatus.WAITING
        if not self._torque:
            return HandStatus.TORQUE_OFF
        if self._calibration:
            return HandStatus.CALIBRATING
        return HandStatus.CHANGING_SPEED if self.motion.changing_speed else HandStatus.READY

    def silence(self, now: float) -> str:
        """Returns what there is to say of a hand that sends no packets."""
        silent = "The hand is silent." if self.link.heard() else "The hand has not been heard yet."
        return f"{silent} {self.link.foreign(now)}".strip()

    @property
    def calibrating(self) -> bool:
        """Whether a calibration of the fingers is requested or under way."""
        return self._calibration is not None or HandRequest.CALIBRATE_FINGERS in self._requests

    def start(self) -> HandUpdate:
        """Returns the first packet of a driver: torque on, targets are positions."""
        return HandUpdate(send=(encode_mode(POSITION),))

    def stop(self, hold: bool = False) -> HandUpdate:
        """Returns the last packet of a driver: torque off. With `hold` the motors keep torque and goals: no packet,
        but in the midst of a change of speed torque on."""
        if hold:
            kept = "The motors keep torque and goals, without protection from overload, until a driver starts again."
            send = (encode_mode(POSITION),) if self.motion.changing_speed else ()
            return HandUpdate(send=send, notes=(HandNote("warning", kept),))
        return HandUpdate(send=(encode_mode(IDLE),))

    def receive(self, data: bytes, source: tuple, now: float) -> HandUpdate:
        """Handles a datagram from `source` (address, port)."""
        complaint_period_s = 10.0
        arrival, packet, why = self.link.sort(data, source, now)
        if packet is None:
            if why and now - self._complaint_time > complaint_period_s:
                self._complaint_time = now
                self._note("warning", why)
            return self._result()
        previous = self.reading.packet if self.reading else None
        recovery = RECOVERIES.get(arrival)
        if recovery is None and previous and servo_fault(previous.positions) and not servo_fault(packet.positions):
            recovery = HandRecovery.SERVOS_ANSWER
        if recovery is not None:
            self._recover(recovery, packet, now)
            previous = None
        loads = self.reading.loads if self.reading and arrival is PacketArrival.NEXT else UNLOADED
        reading = measure(packet, self._zeros, self._offsets, self._thresholds, loads)
        self.reading = reading
        self._serve_requests(packet, now)
        if self._calibration:
            self._calibrate(self._calibration, reading, now)
        elif self._torque and self._new_zeros is None:  # the reading's angles are those of the old zeros
            packets, notes = self.motion.protect(reading, previous, self._zeros.motor_zero_reference, self.calibrated)
            self._send.extend(packets)
            self._notes.extend(notes)
        return self._result(reading=reading)

    def tick(self, now: float) -> HandUpdate:
        """Handles the passing of time: packets of a speed change, silence, requests that waited too long."""
        self._send.extend(self.motion.step(now))
        if self.link.watch(now):
            self._note("error", f"The hand is silent: no packet for {self._settings.silence_time:g} s.")
            self._tactile = None
            if self._calibration:
                self._fail("The hand fell silent.")
        for request, since in list(self._requests.items()):
            if now - since > self._settings.request_time:
                del self._requests[request]
                self._note(
                    "error", f"{request.value} was given up: no packet came for {self._settings.request_time:g} s."
                )
        return self._result()

    def command(self, angles: Sequence[float], now: float) -> HandUpdate:
        """Sends the motors to joint angles [rad], clamped to their travel; during a calibration, after its end."""
        angles = tuple(float(a) for a in angles)
        if len(angles) != 4 or not all(math.isfinite(a) for a in angles):
            return self._result(f"The command {list(angles)} is not four finite angles; the last goal stays.")
        refusal = self._refused(HandRequest.COMMAND, now)
        if not refusal and self._calibration:
            self._waiting_command = angles
        elif not refusal:
            refusal = self._command(angles)
        return self._result(refusal)

    def command_raw(self, positions: Sequence[int], now: float) -> HandUpdate:
        """Sends the servos to positions [ticks] as they are; for tests of the hand. Refused during a calibration."""
        refusal = self._refused(HandRequest.RAW_COMMAND, now)
        if not refusal:
            try:
                self._aim(tuple(int(p) for p in positions))
                self.commands += 1
            except ValueError as error:
                refusal = f"The command was refused: {error}."
        return self._result(refusal)

    def set_speed(self, speeds: Sequence[float], now: float) -> HandUpdate:
        """Begins to set the joint speeds [rad/s]; the state is CHANGING_SPEED until it is done. Switches torque on."""
        wrong = "they are four" if len(speeds) != 4 else setting_fault("default_speed", speeds)
        if wrong:
            return self._result(f"The speeds {list(speeds)} were refused: {wrong}.")
        refusal = self._refused(HandRequest.SPEED, now)
        if refusal or self.reading is None:
            return self._result(refusal)
        positions = self.reading.packet.positions
        fault = servo_fault(positions)
        if fault and not self._torque:
            return self._result(f"{fault} Torque stays off.")
        self._send.extend(self.motion.change_speed(speeds, now))
        self._speeds = tuple(speeds)
        if not self._torque:
            self._torque = True
            self._aim(positions)
        return self._result()

    def disable_torque(self) -> HandUpdate:
        """Lets all motors go; torque returns with `set_speed`."""
        self._torque = False
        self._waiting_command = None
        self._requests.pop(HandRequest.CALIBRATE_FINGERS, None)
        if self._calibration:
            self._fail("Torque was switched off.")
        self.motion.reset()
        self._send.append(encode_mode(IDLE))
        return self._result()

    def calibrate_fingers(self, now: float) -> HandUpdate:
        """Requests the finger calibration, which begins with the next packet; no effect during one."""
        return self._result("") if self._calibration else self._ask(HandRequest.CALIBRATE_FINGERS, now)

    def calibrate_tactile(self, now: float) -> HandUpdate:
        """Requests that the next packets zero the tactile sensors."""
        return self._ask(HandRequest.CALIBRATE_TACTILE, now)

    def zero_pose(self, now: float) -> HandUpdate:
        """Requests that the pose of the next packet becomes zero, with the fingers let out by the slack."""
        return self._ask(HandRequest.ZERO_POSE, now)

    def set_thresholds(self, thresholds: Sequence[Sequence[int]]) -> HandUpdate:
        """Sets the contact thresholds, three times nine counts."""
        wrong = setting_fault("default_contact_threshold", [count for row in thresholds for count in row])
        if wrong or [len(row) for row in thresholds] != [9] * 3:
            return self._result(f"The thresholds were refused: {wrong or 'they are three times nine'}.")
        self._thresholds = tuple(tuple(row) for row in thresholds)
        return self._result()

    def _clear(self) -> None:
        self._send: list[bytes] = []
        self._notes: list[HandNote] = []
        self._new_zeros: FingerZeros | None = None
        self._new_offsets: TactileOffsets | None = None

    def _result(self, refusal: str = "", reading: HandReading | None = None) -> HandUpdate:
        zeros, offsets = self._new_zeros, self._new_offsets
        update = HandUpdate(tuple(self._send), tuple(self._notes), refusal, reading, zeros, offsets)
        self._clear()
        self.refused += bool(refusal)
        return update

    def _note(self, level: str, text: str) -> None:
        self._notes.append(HandNote(level, text))

    def _refused(self, request: HandRequest, now: float) -> str:
        holds = {
            HandStatus.SILENT: not self.link.alive(now),
            HandStatus.TORQUE_OFF: not self._torque,
            HandStatus.CALIBRATING: self._calibration is not None,
        }
        found = [sentence for state, requests, sentence in REFUSALS if holds[state] and request in requests]
        return (found[0] or self.silence(now)) if found else ""

    def _ask(self, request: HandRequest, now: float) -> HandUpdate:
        refusal = self._refused(request, now)
        if not refusal:
            self._requests[request] = now
        return self._result(refusal)

    def _recover(self, recovery: HandRecovery, packet: StatePacket, now: float) -> None:
        if self._calibration:
            self._fail("The hand was interrupted.")
        self._note(recovery.level, recovery.sentence)
        if recovery.servos_started:
            self._start_servos(packet, now)
        elif not self.motion.changing_speed:
            self._send.append(encode_mode(POSITION if self._torque else IDLE))

    def _start_servos(self, packet: StatePacket, now: float) -> None:
        """Servos may have lost torque, speed and turn: restores the first two and holds them where they are."""
        self.motion.reset()
        fault = servo_fault(packet.positions)
        if fault:
            self._note("error", fault)
        elif self._torque:
            self._send.extend(self.motion.change_speed(self._speeds, now))
            self._aim(packet.positions)

    def _serve_requests(self, packet: StatePacket, now: float) -> None:
        if self._requests.pop(HandRequest.CALIBRATE_TACTILE, None) is not None:
            self._tactile = []
        if self._tactile is not None:
            self._tactile.append(packet)
            if len(self._tactile) >= self._settings.tactile_packets:
                self._offsets = self._new_offsets = mean_offsets(self._tactile)
                self._tactile = None
                self._note("info", "The tactile sensors are zeroed.")
        if self.motion.changing_speed:
            return
        if self._requests.pop(HandRequest.ZERO_POSE, None) is not None:
            self._take_zero_pose(packet)
        if self._torque and self._requests.pop(HandRequest.CALIBRATE_FINGERS, None) is not None:
            self._note("info", CALIBRATING)
            self.calibration_outcome = "under way"
            self._calibration = FingerCalibration(self._settings)

    def _take_zero_pose(self, packet: StatePacket) -> None:
        fault = servo_fault(packet.positions)
        if fault:
            self._note("error", f"zero_pose was refused. {fault}")
            return
        slack = self._settings.calibration_slack
        self._adopt(zeros_here(packet.encoders, packet.positions, slack))
        self._note("info", "This pose is zero now, with the fingers' tendons let out.")
        if self._torque:
            self._aim(open_positions(packet.positions, slack))

    def _calibrate(self, calibration: FingerCalibration, reading: HandReading, now: float) -> None:
        step = calibration.step(reading.packet, reading.loads, now)
        if step.target is not None:
            self._aim(step.target)
        if step.failure:
            self._fail(step.failure)
        if step.zeros is not None:
            self._calibration = None
            self.calibration_outcome = "succeeded"
            self._adopt(step.zeros)
            self._note("info", "The fingers are calibrated.")
            waiting, self._waiting_command = self._waiting_command, None
            refusal = self._command(waiting) if waiting is not None else ""
            if refusal:
                self.refused += 1
                self._note("warning", refusal)

    def _fail(self, sentence: str) -> None:
        self._calibration = self._waiting_command = None
        self.calibration_outcome = f"failed: {sentence}"
        self._note("error", f"The finger calibration failed, the old one stays. {sentence}")

    def _adopt(self, zeros: FingerZeros) -> None:
        self._zeros = self._new_zeros = zeros
        self.calibrated = True
        self.motion.guard.reset()

    def _aim(self, positions: tuple[int, ...]) -> None:
        self._send.extend(self.motion.aim(positions))

    def _command(self, angles: tuple[float, ...]) -> str:
        if not self.calibrated or self.reading is None:
            return "This hand has never been calibrated: calibrate the fingers."
        zeros = self._zeros.motor_zero_reference
        packets, refusal = self.motion.command(angles, self.reading.packet.positions, zeros)
        self._send.extend(packets)
        self.commands += not refusal
        return refusal
