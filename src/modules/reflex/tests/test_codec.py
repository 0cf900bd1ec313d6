"""Bytes of the wire: against packets written by hand, and against the simulated hand's own code."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reflex.codec import IDLE, POSITION, VELOCITY, PacketError, decode_state, encode_mode, encode_target, is_command
from rig_simulation.devices.reflex.wire import pack_state, read_command

u8, u16, u32 = st.integers(0, 255), st.integers(0, 65535), st.integers(0, 2**32 - 1)
nine = st.lists(u16, min_size=9, max_size=9).map(tuple)
three16, four16 = st.tuples(u16, u16, u16), st.tuples(u16, u16, u16, u16)
four8 = st.tuples(u8, u8, u8, u8)

GOLDEN_STATE = bytes.fromhex(
    "01 000000"
    "40420f00"  # 1 000 000 us
    "8200 8300 8400 8500 8600 8700 8800 8900 8a00"  # bank 0 is f1: 130..138
    "9600 9700 9800 9900 9a00 9b00 9c00 9d00 9e00"  # bank 1 is f3: 150..158
    "aa00 ab00 ac00 ad00 ae00 af00 b000 b100 b200"  # bank 2 is f2: 170..178
    + "0000" * 11
    + "0002" * 38
    + "0100 0020 ff3f"  # encoders 1, 8192, 16383
    "00 01 20 24"  # errors
    "5235 8333 6b34 8234"  # positions 13650, 13187, 13419, 13442
    "6401 6405 0000 ff03"  # speeds 356, 1380, 0, 1023
    "2704 2800 0004 ff07"  # loads 1063, 40, 1024, 2047
    "78 79 7a 7b"  # 12.0 V to 12.3 V
    "1b 22 2a 50"  # 27, 34, 42, 80 degrees
)


def test_golden_state_packet():
    packet = decode_state(GOLDEN_STATE)
    assert packet.device_time == 1_000_000
    assert packet.pressures == (tuple(range(130, 139)), tuple(range(170, 179)), tuple(range(150, 159)))
    assert packet.encoders == (1, 8192, 16383)
    assert packet.errors == (0, 1, 0x20, 0x24)
    assert packet.positions == (13650, 13187, 13419, 13442)
    assert packet.speeds == (356, 1380, 0, 1023)
    assert packet.loads == (1063, 40, 1024, 2047)
    assert packet.voltages == (120, 121, 122, 123)
    assert packet.temperatures == (27, 34, 42, 80)


def test_simulated_hand_packs_the_golden_packet():
    p = decode_state(GOLDEN_STATE)
    packed = pack_state(
        p.device_time, p.pressures, p.encoders, p.errors, p.positions, p.speeds, p.loads, p.voltages, p.temperatures
    )
    assert packed == GOLDEN_STATE


@pytest.mark.parametrize(
    ("packet", "golden"),
    [
        (encode_mode(POSITION), "01 02 02 02 02"),
        (encode_mode(VELOCITY), "01 01 01 01 01"),
        (encode_mode(IDLE), "01 00 00 00 00"),
        (encode_target((13000, 258, 65535, 1)), "02 32c8 0102 ffff 0001"),
        (encode_target((13650, 13187, 13419, 13442)), "02 3552 3383 346b 3482"),
        (encode_target((118, 1261, 356, 2047)), "02 0076 04ed 0164 07ff"),
    ],
)
def test_golden_commands(packet, golden):
    assert packet == bytes.fromhex(golden)
    assert is_command(packet)


@given(u32, st.tuples(nine, nine, nine), three16, four8, st.tuples(four16, four16, four16, four8, four8))
def test_state_packets_of_the_simulated_hand_come_back_whole(time, pressures, encoders, errors, registers):
    packet = decode_state(pack_state(time, pressures, encoders, errors, *registers))
    assert (packet.device_time, packet.pressures, packet.encoders, packet.errors) == (time, pressures, encoders, errors)
    assert (packet.positions, packet.speeds, packet.loads, packet.voltages, packet.temperatures) == registers


@pytest.mark.parametrize("data", [b"", GOLDEN_STATE[:-1], GOLDEN_STATE + b"\0", b"\2" + GOLDEN_STATE[1:], bytes(388)])
def test_torn_and_foreign_packets_are_refused(data):
    with pytest.raises(PacketError):
        decode_state(data)


def test_a_state_packet_is_no_command_though_it_begins_like_one():
    assert not is_command(GOLDEN_STATE)
    assert read_command(GOLDEN_STATE) is None


@pytest.mark.parametrize("raw", [(1, 2, 3), (-1, 0, 0, 0), (65536, 0, 0, 0), (1.0, 0, 0, 0)])
def test_impossible_targets_are_refused(raw):
    with pytest.raises(ValueError, match="four whole numbers"):
        encode_target(raw)
