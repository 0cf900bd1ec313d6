"""The simulated hand: its servos, fingers and firmware, and how the program starts and ends."""

import math
import re
import signal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common import clock
from common.errors import DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.wire import IDLE, POSITION, VELOCITY, ModeCommand, TargetCommand

CLOSING = np.array([1, -1, 1, -1])


def run(hand, seconds):
    for _ in range(round(seconds / PERIOD_S)):
        hand.step(PERIOD_S)


def close(hand, ticks):
    hand.handle(ModeCommand((POSITION,) * 4))
    positions = np.array(hand.state()["positions"])
    hand.handle(TargetCommand(tuple((positions + CLOSING * ticks).tolist())))


def field(packet, offset, count, size=2):
    return [int.from_bytes(packet[offset + i * size : offset + (i + 1) * size], "little") for i in range(count)]


def test_at_power_up_positions_lie_in_one_turn_and_nothing_has_torque():
    for seed in range(20):
        hand = SimulatedHand(seed)
        assert all(13000 <= p <= 14024 for p in hand.state()["positions"])
        hand.handle(TargetCommand((14000,) * 4))
        before = hand.state()["angles"]
        run(hand, 1.0)
        assert hand.state()["angles"] == before


def test_the_same_seed_is_the_same_hand():
    assert SimulatedHand(7).packet() == SimulatedHand(7).packet() != SimulatedHand(8).packet()


def test_closing_raises_f1_and_f3_and_lowers_f2_and_preshape():
    hand = SimulatedHand(2)
    before = np.array(hand.state()["positions"])
    close(hand, 300)
    run(hand, 2.0)
    np.testing.assert_array_equal(np.array(hand.state()["positions"]) - before, CLOSING * 300)
    np.testing.assert_array_less(0.9, hand.state()["angles"])


def test_knuckles_turn_only_after_the_slack_and_lower_their_count():
    hand = SimulatedHand(3)
    first = field(hand.packet(), 160, 3)
    close(hand, 5)
    run(hand, 0.5)
    np.testing.assert_allclose(field(hand.packet(), 160, 3), first, atol=2)
    close(hand, 150)
    run(hand, 1.0)
    turned = np.mod(np.array(first) - field(hand.packet(), 160, 3), 16384)
    np.testing.assert_allclose(turned * 2 * math.pi / 16384, hand.state()["proximal"], atol=0.002)
    assert min(hand.state()["proximal"]) > 0.2


def test_a_free_finger_shares_the_tendon_and_a_blocked_one_bends_outside_with_load():
    hand = SimulatedHand(1)
    hand.block(0, 0.4, stiffness=300.0)
    close(hand, 400)
    run(hand, 2.0)
    state = hand.state()
    assert state["proximal"][0] == pytest.approx(0.4)
    assert state["distal"][0] == pytest.approx(state["angles"][0] - 0.4)
    assert state["efforts"][0] == pytest.approx(300 * (state["angles"][0] - 0.56), rel=0.01)
    assert state["proximal"][1] == pytest.approx(state["angles"][1] / 1.4)
    assert field(hand.packet(), 186, 4)[0] == 1024 + round(state["efforts"][0])


@pytest.mark.parametrize(("motor", "register"), [(0, 1024 + 300), (1, 300), (2, 1024 + 300), (3, 300)])
def test_a_closing_load_has_the_sign_of_its_motor(motor, register):
    hand = SimulatedHand()
    hand.set_load(motor, 300)
    assert field(hand.packet(), 186, 4)[motor] == register
    hand.set_load(motor, None)
    assert field(hand.packet(), 186, 4)[motor] == 0


def test_speed_is_set_in_velocity_mode_and_kept():
    hand = SimulatedHand(5)
    hand.handle(ModeCommand((VELOCITY,) * 4))
    hand.handle(TargetCommand((100, 1124, 1, 0)))
    assert hand.state()["torque"] == [False] * 4
    before = np.array(hand.state()["positions"])
    close(hand, 800)
    run(hand, 1.0)
    moved = (np.array(hand.state()["positions"]) - before) * CLOSING * 2 * math.pi / 1024
    np.testing.assert_allclose(moved[:3], [1.194, 1.194, 0.0119], atol=0.01)
    assert moved[3] > 2.0, "0 is full speed"
    assert field(hand.packet(), 178, 2) == [1124, 100]


def test_the_last_motors_mode_decides_how_targets_are_read():
    hand = SimulatedHand()
    hand.handle(ModeCommand((POSITION, POSITION, POSITION, VELOCITY)))
    hand.handle(TargetCommand((1, 2, 3, 4)))
    assert hand.state()["speed_settings"] == [1, 2, 3, 4]
    hand.handle(ModeCommand((IDLE, IDLE, IDLE, POSITION)))
    hand.handle(TargetCommand((13000, 13001, 13002, 13003)))
    assert hand.state()["goals"] == [13000, 13001, 13002, 13003]
    assert hand.state()["torque"] == [False, False, False, True]


@settings(max_examples=30)
@given(
    st.lists(
        st.one_of(
            st.tuples(*[st.integers(0, 255)] * 4).map(ModeCommand),
            st.tuples(*[st.integers(0, 65535)] * 4).map(TargetCommand),
            st.just(ModeCommand((POSITION,) * 4)),
        ),
        max_size=20,
    )
)
def test_any_commands_leave_a_hand_that_packs_its_state(commands):
    hand = SimulatedHand()
    for command in commands:
        hand.handle(command)
        run(hand, 0.1)
        assert len(hand.packet()) == 202
        assert all(-20.1 < a < 4.01 for a in hand.state()["angles"])


def test_a_power_cycle_forgets_the_turn_but_not_the_pose():
    hand = SimulatedHand(9)
    close(hand, 850)
    run(hand, 2.0)
    before = hand.state()
    hand.power_cycle()
    after = hand.state()
    assert after["angles"] == before["angles"]
    assert all(13000 <= p <= 14024 for p in after["positions"])
    np.testing.assert_array_equal(np.mod(np.subtract(after["positions"], before["positions"]), 1024), 0)
    assert after["torque"] == [False] * 4 and after["time"] == 0


@pytest.mark.ros
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--interface", "eth77"), "'eth77'"),
    ],
)
def test_ends_with_a_sentence(virtual_graph, arguments, sentence):
    program = virtual_graph.run("rig_simulation", "reflex_hand.py", *arguments)
    assert program.wait(1.0) != 0
    assert sentence in program.log
    assert "Traceback" not in program.log and "control port 1" not in program.log


@pytest.fixture
def program(virtual_graph, network):
    """Starts the program; returns it, its UDP port and a client of its control port."""
    arguments = ("--port", "0", "--control-port", "0", "__name:=hand")
    program = virtual_graph.run("rig_simulation", "reflex_hand.py", *arguments)
    clock.sleep(PERIOD_S)
    ready = re.fullmatch(r"reflex_hand: on lo, UDP port (\d+), control port 127\.0\.0\.1:(\d+)\n", program.log)
    return program, ready[1], ControlClient("127.0.0.1", int(ready[2]))


@pytest.mark.ros
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_one_ready_line_and_a_clean_end(program, number):
    process, _, control = program
    assert control.ask("state")["targets_received"] == 0
    process.send_signal(number)
    assert process.wait(PERIOD_S) == 0
    assert process.log.count("\n") == 1


@pytest.mark.ros
@pytest.mark.parametrize(
    "request_fields",
    [
        {"do": "set_load", "motor": 4, "value": 1},
        {"do": "set_load", "motor": 0, "value": 5000},
        {"do": "press", "finger": 3, "value": 1},
        {"do": "press", "finger": 0, "cell": 9, "value": 1},
        {"do": "block", "finger": 0, "proximal": -1},
        {"do": "set_servo", "motor": 0, "temperature": 300},
        {"do": "dance"},
    ],
)
def test_the_control_port_refuses_nonsense(program, request_fields):
    _, _, control = program
    with pytest.raises(DeviceError):
        control.ask(**request_fields)
    assert control.ask("state")["mode"] == [IDLE] * 4
