"""Laws of the engagement: whatever happens in whatever order, the arm moves only for a hand that may steer it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from common.config import parse
from common.hand_tracking import MAX_STEP_M, REMEMBERED_S, succeeds
from common.poses import pose
from common.rotations import rotation_from_zyx
from golden.chain import parsed
from leap_kuka.config import ArmPlacement
from leap_kuka.engagement import TRANSITIONS, EngagementState, EngagementTrigger, Tool, When, next_state
from leap_kuka.numbers import DEVICE_SILENCE_S, LEAD_GONE_S, MAX_SILENCE_S
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState
from leap_kuka.tool_hold import HoldState
from leap_kuka.virtual_leap import R_LEAP_REFERENCE
from leap_motion.frames import TrackedHand, TrackingFrame

HOME = pose(np.diag([-1.0, 1.0, -1.0]), (0.42, -0.42, 0.4))
PLACES = {"box": 0.0, "edge": 0.08, "beside": 0.115, "out": 0.25}  # of the palm, to the right of the box's centre [m]
ENDS = {Tool.GONE, Tool.STAYS}


def placement():
    values = {**vars(parsed("kuka", {})), "ws_center": HOME[:3, 3]}
    return parse(ArmPlacement, values, "kuka/", others=values)


BOX = ArmTeleop(parsed("leap", {}, others=("operator_input",)), placement()).box.center


def hand(number, place, yaw=0.0, confidence=1.0, grab=0.0):
    R = R_LEAP_REFERENCE @ rotation_from_zyx(np.radians(yaw), 0.0, 0.0)
    position = np.add(BOX, (PLACES[place], 0.0, 0.0))
    return TrackedHand(number, number % 2 == 1, position, R[:, 0], R[:, 2], confidence, grab=grab)


KINDS = {  # relative or not, hold_time, whether devices enable, clutch and choose
    "absolute": (False, 0.0, False),
    "home": (True, 0.0, False),
    "kept": (True, 1.0, False),
    "switched": (True, 1.0, True),
}


STEPS = {"near": 0.01, "here": 0.0, "far": 0.2, "no number": math.nan}  # of a program, upwards [m]
STOPS = ("clutch", "release", "silence", "other arm")


class Engagement(RuleBasedStateMachine):
    """An arm that is where it is told at once, its controller, two hands, the operator's device, a choice of arm."""

    @initialize(kind=st.sampled_from([*KINDS, "switched"]), known=st.booleans(), engaged=st.booleans())
    def begin(self, kind, known, engaged=False):
        self.kind = kind
        relative, hold_time, switched = KINDS[kind]
        changes = {"engagement": "relative" if relative else "absolute", "hold_time": hold_time}
        if switched:
            changes.update(enabling="device", clutch="device", arm_choice="service")
        self.switched = switched
        self.teleop = ArmTeleop(parsed("leap", changes, others=("operator_input",)), placement(), measured_tool=self.at)
        self.box = self.teleop.box
        self.tool, self.mode, self.control_on, self.silent = HOME, "home", False, 1.0
        self.pressed, self.clutched, self.device_there, self.chosen = False, False, True, True
        self.reported, self.reported_at = (False, False), -math.inf  # pressed and clutched, in the newest message
        self.hands, self.now, self.number = {}, 50.0, 0
        self.outside, self.may = {}, set()  # frames in a row outside of the box; hands that came in while control is on
        self.seen = {}  # hands as they were seen last, and when [s]
        self.last = self.sent = None
        self.led = False  # whether a pose of a program was taken since the frame before
        self.allowed = False  # whether a program may steer
        self.told = known
        self.frames(1)
        if engaged:
            self.engage(2)

    def at(self):
        return self.tool

    @rule(number=st.sampled_from([2, 3, 4]), place=st.sampled_from([*PLACES]), yaw=st.sampled_from([0.0, 30.0]))
    def move(self, number, place, yaw):
        self.hands[number] = hand(number, place, yaw)
        self.frames(5)

    @rule(number=st.sampled_from([2, 3, 4]))
    def leave(self, number):
        self.hands.pop(number, None)
        self.frames(2)

    @rule(number=st.sampled_from([2, 4]))
    def come_in(self, number):
        """As an operator does."""
        self.hands = {number: hand(number, "out")}
        self.frames(4)
        self.hands = {}
        self.frames(2)
        self.hands = {number: hand(number, "box")}
        self.frames(45)

    @rule(number=st.sampled_from([2, 4]))
    def engage(self, number):
        """All that an engagement needs."""
        self.switch(True)
        self.mode, self.tool = "home", HOME
        self.clutched, self.device_there, self.chosen = False, True, True
        self.frames(40)
        self.press()
        self.come_in(number)
        self.drift()

    @rule(number=st.sampled_from([2, 4]))
    def rest(self, number):
        """A hand came in before, and rests in the box when control is switched on."""
        self.switch(False)
        self.come_in(number)
        self.frames(60)
        self.switch(True)
        self.frames(45)
        self.drift()

    @rule(number=st.sampled_from([2, 4]), stop=st.sampled_from(STOPS))
    def stop(self, number, stop):
        """The operator stops the tool, and the hand moves on."""
        self.engage(number)
        self.clutched, self.pressed = stop == "clutch", stop != "release"
        self.device_there, self.chosen = stop != "silence", stop != "other arm"
        self.frames(1)
        self.drift()
        if stop == "silence":
            self.drift()  # beyond DEVICE_SILENCE_S

    @rule(number=st.sampled_from([2, 4]), unsure=st.booleans())
    def hide(self, number, unsure):
        if number in self.hands:
            self.hands[number] = dataclasses.replace(self.hands[number], confidence=0.0 if unsure else 1.0)
        self.frames(2)

    @rule(count=st.integers(1, 60))
    def frames(self, count):
        for _ in range(count):
            self.frame()

    @rule()
    def drift(self):
        """The hands move slowly."""
        for _ in range(20):
            for number, seen in self.hands.items():
                self.hands[number] = dataclasses.replace(seen, palm=np.add(seen.palm, (0.0, 0.001, 0.0)))
            self.frame()

    @rule(on=st.booleans())
    def switch(self, on):
        self.told = True
        if on and not self.control_on:
            self.may, self.outside = set(), {}
        self.control_on = on
        self.frames(1)

    @rule()
    def press(self):
        """The enabling device, released and pressed."""
        self.pressed = False
        self.frames(2)
        self.pressed = True
        self.frames(2)

    @rule(pressed=st.booleans(), clutched=st.booleans(), there=st.booleans(), chosen=st.booleans())
    def device(self, pressed, clutched, there, chosen):
        self.pressed, self.clutched, self.device_there, self.chosen = pressed, clutched, there, chosen
        self.drift()

    @rule(step=st.sampled_from([*STEPS]), frames=st.integers(1, 5), silent=st.booleans())
    def program(self, step, frames, silent):
        """A program steers for some frames; then it may be silent."""
        for _ in range(frames):
            self.lead(STEPS[step])
            self.frames(1)
        if silent:
            self.frames(25)

    def lead(self, step):
        T = np.array(self.tool if self.sent is None else self.sent)
        T[2, 3] += step
        if not self.allowed:
            self.teleop.allow_lead(True, self.now)
            self.allowed = True
        self.led = not self.teleop.lead(T, self.now)

    @rule(mode=st.sampled_from(["stopped", "moving", "holding", "pick_up", "servo", "home"]))
    def arm(self, mode):
        self.mode = mode
        self.frames(2)

    @rule(dt=st.sampled_from([0.06, 0.19, 0.3, 1.1]))
    def pause(self, dt):
        """No frames come, and the watch looks."""
        self.now += dt
        self.teleop.silence(self.now)
        if dt > 0.2:
            self.sent = None
        self.frame(dt)

    def frame(self, dt=0.01):
        self.now += dt
        self.number += 1
        if self.told:
            self.teleop.control(self.control_on, self.mode, 1.0, self.now)
        if self.switched:
            self.teleop.choose(None if self.chosen else "the hand steers the other arm", True)
            if self.device_there:
                self.reported, self.reported_at = (self.pressed, self.clutched), self.now
                self.teleop.switches.device.take(*self.reported, "pedal", 0.0, self.now)
        owner, hands = self.last.owner if self.last else None, tuple(self.hands.values())
        self.renumber(hands)
        for seen in hands:
            out = self.box.outside(seen.palm) > 0.02
            self.outside[seen.id] = self.outside.get(seen.id, 0) + 1 if out else 0
            if self.outside[seen.id] >= 3:
                self.may.add(seen.id)
        result = self.teleop.step(TrackingFrame(self.number, 0.0, hands), self.now)
        self.judge(result)
        if owner is not None and result.owner is None and result.hold is not HoldState.KEPT:
            self.may, self.outside = set(), {}
        self.last = result
        self.allowed &= result.hold is not HoldState.NONE
        tool = None if result.T_virtual_tool is None else result.T_base_virtual @ result.T_virtual_tool
        self.sent = tool
        follows = self.control_on and tool is not None and self.mode in ("home", "pick_up", "servo")
        self.silent = 0.0 if follows else self.silent + dt
        if follows:
            self.tool, self.mode = tool, "servo"
        elif self.mode == "servo" and self.silent > 0.2:
            self.tool, self.mode = HOME, "home"

    def renumber(self, hands):
        """A hand that has left and comes back in place under another number is the same one."""
        numbers = {seen.id for seen in hands}
        for seen in hands:
            for before, at in self.seen.values():
                elapsed = self.now - at
                gone = before.id not in numbers and elapsed <= MAX_SILENCE_S
                if seen.id not in self.seen and gone and succeeds(seen, before, elapsed):
                    self.may |= {seen.id} if before.id in self.may else set()
                    self.outside[seen.id] = self.outside.get(before.id, 0)
        self.seen = {number: (hand, at) for number, (hand, at) in self.seen.items() if self.now - at <= REMEMBERED_S}
        self.seen.update({seen.id: (seen, self.now) for seen in hands})

    def judge(self, result):
        if result.T_virtual_tool is None or not (self.told and self.control_on):
            return
        tool, running = result.T_base_virtual @ result.T_virtual_tool, result.state is StreamState.RUNNING
        moved = self.sent is None or not np.allclose(tool, self.sent, atol=1e-9)
        led, self.led = self.led, False
        if led and result.hold is HoldState.LED:
            self.judge_program(result)
            return
        if self.sent is None and result.hold is HoldState.NONE:
            assert running, "a tool appears only for a hand"
        if moved and self.sent is not None:
            assert running and result.follows, result.reason
        if not (running and moved):
            return
        assert result.owner is not None and result.owner[0] in self.may, f"{result.owner} did not come in: {self.may}"
        if self.switched:
            silence = self.now - self.reported_at
            assert self.chosen and self.reported == (True, False) and silence <= DEVICE_SILENCE_S, result.reason

    def judge_program(self, result):
        assert self.kind in ("kept", "switched") and result.owner is None and not result.follows
        assert self.sent is None or np.linalg.norm(self.led_step(result)) <= MAX_STEP_M + 1e-9
        if self.switched:
            silence = self.now - self.reported_at
            assert self.chosen and self.reported == (True, False) and silence <= DEVICE_SILENCE_S, result.reason

    def step(self, T_lead=None):
        """A frame without hands 10 ms later, with a pose of a program."""
        self.now, self.number = self.now + 0.01, self.number + 1
        return self.teleop.step(TrackingFrame(self.number, 0.0, ()), self.now, T_lead)

    def led_step(self, result):
        return (result.T_base_virtual @ result.T_virtual_tool - self.sent)[:3, 3]


def test_the_machine_engages():
    """The laws would hold for a machine in which no hand ever steers."""
    for kind in KINDS:
        machine = Engagement()
        machine.begin(kind, True)
        machine.engage(2)
        assert machine.last.follows and not np.allclose(machine.sent, HOME), machine.last.reason


@pytest.mark.parametrize("stop", STOPS)
def test_the_machine_tries_each_stop(stop):
    machine = Engagement()
    machine.begin("switched", True)
    machine.stop(2, stop)
    assert not machine.last.follows


@pytest.mark.parametrize("kind", KINDS)
def test_the_machine_is_led_where_the_tool_can_stay(kind):
    machine = Engagement()
    machine.begin(kind, True)
    machine.switch(True)
    machine.press()
    wanted, heights = pose(HOME[:3, :3], HOME[:3, 3] + (0.0, 0.0, 0.04)), []
    machine.teleop.allow_lead(True, machine.now)
    for _ in range(130):
        machine.led = not machine.teleop.lead(wanted, machine.now)
        machine.frames(1)
        if machine.sent is not None:
            heights.append(machine.sent[2, 3])
    assert (machine.last.hold is HoldState.LED) == (kind in ("kept", "switched"))
    if kind in ("kept", "switched"):
        np.testing.assert_allclose(machine.sent, wanted, atol=1e-9)
        assert heights[0] == pytest.approx(HOME[2, 3], abs=1e-4)
        assert np.diff(heights).min() >= 0.0 and np.diff(heights).max() < 0.0008, "it goes there slowly"
        machine.frames(25)
        assert machine.last.hold is HoldState.KEPT and "the program is silent" in machine.last.reason
        machine.program("here", 1, False)
        machine.come_in(2)
        machine.drift()
        assert machine.last.follows and machine.teleop.lead(machine.sent, machine.now) == "a hand is followed"


LEAD_REFUSED = {
    "clutch": "the clutch is pressed",
    "release": "the enabling device is not pressed",
    "other arm": "the hand steers the other arm",
    "control off": "control of the arm is off",
    "far": "its pose is 200 mm and 0 deg from the tool",
    "turned": "its pose is 0 mm and 30 deg from the tool",
    "no number": "4 x 4 finite numbers",
    "too near": "it is too near to the base, behind it or below its foot",
    "mode": "its controller is in the mode holding",
}


@pytest.mark.parametrize("why", LEAD_REFUSED)
def test_a_program_that_may_not_is_refused_and_the_tool_stays(why):
    machine = Engagement()
    machine.begin("switched", True)
    machine.switch(True)
    machine.press()
    machine.program("here", 3, False)
    assert machine.last.hold is HoldState.LED
    where, T = np.array(machine.sent), np.array(machine.sent)
    machine.clutched, machine.pressed, machine.chosen = why == "clutch", why != "release", why != "other arm"
    if why == "control off":
        machine.teleop.control(False, "servo", 1.0, machine.now)
    elif why == "mode":
        machine.teleop.control(True, "holding", 1.0, machine.now)
    elif why in LEAD_REFUSED and why in STOPS:
        machine.frames(1)
        assert machine.last.hold is HoldState.KEPT, "also without a further pose"
        T[2, 3] += 0.01
    elif why == "far":
        T[2, 3] += 0.2
    elif why == "turned":
        T = T @ pose(rotation_from_zyx(math.radians(30.0), 0.0, 0.0), np.zeros(3))
    elif why == "no number":
        T[0, 3] = math.nan
    else:
        T[:3, 3] = (-0.4, 0.0, 0.3)
    assert LEAD_REFUSED[why] in machine.teleop.lead(T, machine.now)
    machine.frames(1)
    assert machine.last.hold is not HoldState.LED
    assert machine.sent is None or np.allclose(machine.sent, where)


def allowed(kind="kept", **changes) -> Engagement:
    """A machine at home with control on, whose program may steer."""
    machine = Engagement()
    machine.begin(kind, True)
    machine.switch(True)
    machine.press()
    machine.teleop.allow_lead(True, machine.now)
    machine.allowed = True
    return machine


def test_nothing_is_led_that_nobody_allowed_and_the_permission_ends_with_control_and_with_the_program():
    machine = allowed()
    machine.teleop.allow_lead(False, machine.now)
    assert "run_policy" in machine.teleop.lead(HOME, machine.now)
    machine = allowed()
    machine.switch(False)
    assert machine.teleop.allow_lead(True, machine.now) == "control of the arm is off"
    machine.switch(True)
    assert "run_policy" in machine.teleop.lead(HOME, machine.now)
    machine = allowed()
    machine.frames(int(100 * LEAD_GONE_S) + 2)
    assert "so it may no longer" in machine.teleop.lead_fault
    assert "run_policy" in machine.teleop.lead(HOME, machine.now)


def test_a_tool_that_a_program_has_left_for_too_long_is_not_led_again_unasked():
    machine = allowed()
    for _ in range(40):
        machine.lead(0.0)
        machine.frames(1)
    for _ in range(170):  # beyond hold_time
        assert machine.teleop.lead(pose(HOME[:3, :3], (0.4, -0.4, 0.7)), machine.now)
        machine.frames(1)
    assert machine.last.hold is HoldState.NONE
    machine.frames(60)
    assert "run_policy" in machine.teleop.lead(HOME, machine.now)


@pytest.mark.parametrize("side", ["left", "right"])
def test_any_hands_fist_is_the_clutch_of_a_tool_that_is_led(side):
    machine = Engagement()
    machine.begin("kept", True)
    changes = {"engagement": "relative", "hold_time": 1.0, "clutch": "second_hand_fist", "hand": "right"}
    leap = parsed("leap", changes, others=("operator_input",))
    machine.teleop = ArmTeleop(leap, placement(), measured_tool=machine.at)
    machine.frames(2)
    machine.switch(True)
    for _ in range(20):
        machine.lead(0.002)
        machine.frames(1)
    assert machine.last.hold is HoldState.LED
    machine.hands = {3 if side == "left" else 2: hand(3 if side == "left" else 2, "out", grab=1.0)}
    machine.frames(1)
    assert machine.last.hold is HoldState.KEPT and machine.last.clutched
    assert "clutch" in machine.teleop.lead(machine.sent, machine.now)


def test_repeated_frames_bring_a_led_tool_no_further():
    machine = allowed()
    for _ in range(120):
        machine.lead(0.0)
        machine.frames(1)
    before, T = np.array(machine.sent), np.array(machine.sent)
    for _ in range(12):
        T = T @ pose(p=(0.0, 0.0, -0.015))
        machine.now += 0.01
        machine.teleop.step(TrackingFrame(machine.number, 0.0, ()), machine.now, T)
    result = machine.step(before)
    np.testing.assert_allclose(result.T_base_virtual @ result.T_virtual_tool, before, atol=1e-9)


def test_before_the_arm_follows_a_led_tool_stays():
    machine = allowed()
    for step in range(30):
        machine.teleop.control(True, "home", 1.0, machine.now)
        result = machine.step(pose(HOME[:3, :3], HOME[:3, 3] + (0.0, 0.0, 0.001 * step)))
        np.testing.assert_allclose(result.T_base_virtual @ result.T_virtual_tool, HOME, atol=1e-9)
    assert result.hold is HoldState.LED


def test_while_the_controller_is_silent_nothing_is_led():
    machine = allowed()
    machine.told = False
    machine.frames(1)
    for _ in range(200):
        machine.step(HOME)
    assert "controller is silent" in machine.teleop.lead_fault


def test_an_arm_that_is_not_at_home_is_not_led_from_there_as_no_hand_steers_it_from_there():
    machine = allowed()
    machine.mode = "servo"
    machine.teleop.control(True, "servo", 1.0, machine.now)
    assert "the arm is not at home" in machine.teleop.lead(HOME, machine.now)


def test_a_tracker_that_is_too_slow_for_a_hand_is_too_slow_for_a_program():
    machine = allowed()
    for _ in range(20):
        machine.lead(0.0)
        machine.frame(0.1)
    assert "frames per second" in machine.teleop.lead(HOME, machine.now)


def test_a_tool_that_is_led_far_ahead_of_the_arm_comes_back_when_it_is_stopped():
    machine = allowed()
    arm = {"T": HOME}
    machine.teleop._measured_tool = lambda: arm["T"]
    for _ in range(150):
        machine.lead(0.002)
        machine.frames(1)
    ahead = machine.sent[2, 3] - HOME[2, 3]
    assert ahead > 0.1
    machine.teleop.allow_lead(False, machine.now)
    for _ in range(60):
        machine.teleop.control(True, "servo", 1.0, machine.now)
        result = machine.step()
    left = (result.T_base_virtual @ result.T_virtual_tool)[2, 3] - HOME[2, 3]
    assert left < 0.06


TestEngagement = Engagement.TestCase
TestEngagement.settings = settings(max_examples=50, stateful_step_count=15, deadline=None)


def test_the_tool_moves_only_in_one_state_and_each_end_is_a_rest():
    assert [state for state in EngagementState if state.tool is Tool.FOLLOWS] == [EngagementState.STEERING]
    assert [state for state in EngagementState if state.tool is Tool.LED] == [EngagementState.LED]
    for row in TRANSITIONS:
        for source in row.sources:
            if source.running and not row.target.running:
                assert row.target.tool in ENDS and row.trigger is not EngagementTrigger.HAND_READY
            if row.target.running and not source.running:
                assert row.trigger is EngagementTrigger.HAND_READY, "only a hand that meets all conditions starts"


@pytest.mark.parametrize("state", EngagementState)
@pytest.mark.parametrize("relative, keeps", [(False, False), (True, False), (True, True)])
def test_one_row_at_most_holds_for_what_happens(state, relative, keeps):
    valid = {When.ALWAYS, When.KEEPS if keeps else When.DROPS, *([When.RELATIVE] if relative else [])}
    for trigger in EngagementTrigger:
        rows = [r for r in TRANSITIONS if state in r.sources and r.trigger is trigger and r.when in valid]
        assert len(rows) <= 1
        assert next_state(state, trigger, relative, keeps) is (rows[0].target if rows else state)
    for end in (EngagementTrigger.TRACKER_LOST, EngagementTrigger.CONTROL_OFF):
        after = next_state(state, end, relative, keeps)
        assert after is EngagementState.WAITING or (
            end is EngagementTrigger.CONTROL_OFF and after.running and not relative
        )
