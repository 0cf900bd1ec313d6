"""The convention of faults: switching, durations, command line, sentences."""

from __future__ import annotations

import argparse
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig_simulation.faults.arm import ARM_FAULTS
from rig_simulation.faults.camera import CAMERA_FAULTS
from rig_simulation.faults.hand import HAND_FAULTS
from rig_simulation.faults.injection import Fault, Faults, FaultValue, add_option, fraction_of, switch_all
from rig_simulation.faults.leap import LEAP_FAULTS

KNOWN = (
    Fault("cut", "the cable is cut"),
    Fault("slow", "late", FaultValue("delay [s]", 0.2, 0.001, 60.0)),
    Fault("lost", "gone", fraction_of("packets")),
)


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def faults(clock):
    return Faults(KNOWN, clock)


def test_a_fault_is_on_until_it_is_switched_off(faults, clock):
    assert not faults.is_on("cut")
    assert faults.switch("cut") == {"active": ["cut"]}
    clock.now += 1e6
    assert faults.value("cut") == 1.0
    assert faults.switch("cut", on=False) == {"active": []}
    assert faults.value("cut") is None
    faults.switch("cut", on=False)


def test_a_fault_ends_by_itself(faults, clock):
    faults.switch("slow", duration=2.0)
    assert faults.value("slow") == 0.2
    clock.now += 1.9
    assert faults.active() == {"slow": 0.2}
    clock.now += 0.2
    assert faults.active() == {}


def test_a_fault_that_is_on_gets_the_new_value_and_duration(faults, clock):
    faults.switch("slow", duration=2.0)
    faults.switch("slow", value=0.5)
    clock.now += 10.0
    assert faults.active() == {"slow": 0.5}


def test_changes_are_reported_once(faults, clock):
    assert faults.changes() == {}
    faults.switch("cut", duration=1.0)
    faults.switch("slow", value=0.3)
    assert faults.changes() == {"cut": 1.0, "slow": 0.3}
    assert faults.changes() == {}
    faults.switch("slow", value=0.4)
    clock.now += 2.0
    assert faults.changes() == {"slow": 0.4, "cut": None}


def test_all_faults_are_listed(faults):
    faults.switch("slow", value=0.3, duration=5.0)
    cut, slow, lost = faults.describe()["faults"]
    assert cut == {
        "name": "cut",
        "doc": "the cable is cut",
        "value_doc": None,
        "on": False,
        "value": None,
        "left": None,
    }
    assert slow == {"name": "slow", "doc": "late", "value_doc": "delay [s]", "on": True, "value": 0.3, "left": 5.0}
    assert (lost["value_doc"], lost["on"]) == ("fraction of the packets", False)


@pytest.mark.parametrize(
    ("request_fields", "sentence"),
    [
        ({"name": "cutt"}, "cut, lost, slow"),
        ({"name": None}, "None"),
        ({"name": "cut", "on": 1}, "on"),
        ({"name": "cut", "value": 1.0}, "1.0"),
        ({"name": "slow", "value": 61}, "delay [s], 0.001 to 60"),
        ({"name": "slow", "value": math.nan}, "nan"),
        ({"name": "slow", "value": True}, "True"),
        ({"name": "slow", "duration": 0}, "duration"),
        ({"name": "slow", "duration": "1"}, "'1'"),
    ],
)
def test_nonsense_is_refused_and_changes_nothing(faults, request_fields, sentence):
    with pytest.raises(ValueError) as error:
        faults.switch(**request_fields)
    assert sentence in str(error.value)
    assert faults.active() == {}


def test_a_misspelled_name_in_the_device_itself_does_not_pass_for_off(faults):
    with pytest.raises(ValueError):
        faults.is_on("slwo")


@given(st.lists(st.tuples(st.sampled_from(["cut", "slow", "lost"]), st.booleans(), st.floats(0.1, 5.0))))
def test_changes_add_up_to_what_is_active(steps):
    clock = Clock()
    faults, summed = Faults(KNOWN, clock), {}
    for name, on, seconds in steps:
        faults.switch(name, on, duration=seconds)
        clock.now += 0.7
        summed.update(faults.changes())
        assert {name: value for name, value in summed.items() if value is not None} == faults.active()


def parse(*arguments):
    parser = argparse.ArgumentParser()
    add_option(parser, KNOWN)
    return parser.parse_args(arguments).fault


def test_the_command_line(faults, clock):
    options = parse("--fault", "cut", "--fault", "slow:3", "--fault", "lost::0.5")
    assert options == [("cut", None, None), ("slow", 3.0, None), ("lost", None, 0.5)]
    assert parse() == []
    switch_all(faults, options)
    assert faults.active() == {"cut": 1.0, "slow": 0.2, "lost": 0.5}
    clock.now += 4.0
    assert faults.active() == {"cut": 1.0, "lost": 0.5}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("cutt", "cut, lost, slow"),
        ("slow:-1", "'-1'"),
        ("slow:1:x", "'x'"),
        ("slow:1:2:3", "NAME[:SECONDS[:VALUE]]"),
    ],
)
def test_the_command_line_refuses_nonsense(capsys, text, sentence):
    with pytest.raises(SystemExit):
        parse("--fault", text)
    assert sentence in capsys.readouterr().err


FAULTS = {"arm": ARM_FAULTS, "leap": LEAP_FAULTS, "hand": HAND_FAULTS, "camera": CAMERA_FAULTS}
"""The faults by device, as the service simulation/fault names them."""


@pytest.mark.parametrize("device", FAULTS)
def test_every_default_is_in_its_range_and_every_name_is_one_of_its_own(device):
    for fault in FAULTS[device]:
        assert fault.value is None or fault.value.low <= fault.value.default <= fault.value.high
    assert len({fault.name for fault in FAULTS[device]}) == len(FAULTS[device])
