"""The robot's identity: what differs is named, whatever it is; addresses and rates do not matter."""

import dataclasses
import xmlrpc.client

import numpy as np
import pytest
import yaml

from common.config import parse
from common.poses import translation
from kuka_control.limits.line_plan import plan_line
from kuka_control.loop.assembly import line_limits
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.model.rig import Rig
from leap_rig.recording.fingerprint import (
    GROUPS,
    KNOWN,
    LEFT_OUT,
    address,
    differences,
    fingerprint,
    moved_away,
    started_with,
)

CONFIG = "src/kuka_control/config"
OTHER = {"robot": "LBR14R820", "flange": "MF_touch_pneumatisch", "shaping": "none"}


@pytest.fixture
def kuka(pytestconfig):
    values = yaml.safe_load((pytestconfig.rootpath / CONFIG / "kuka_params_rt.yaml").read_text())
    return values.get("kuka", values)


def changed(value):
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value * 1.01 if value else 0.01
    if isinstance(value, list):
        return [changed(value[0]), *value[1:]] if value and not isinstance(value[0], str) else ["another"]
    return OTHER.get(value, "/another")


def test_the_same_parameters_agree_also_when_defaults_are_written_out(kuka):
    one = fingerprint(kuka, str)
    assert all(one[group] for group in GROUPS) and not differences(one, one)
    written = {**kuka, "collision_guard": one["limits"]["collision_guard"], "ip": "10.0.0.1", "time_out": 0.3}
    assert not differences(one, fingerprint(written, str))


@pytest.mark.ros
def test_what_a_controller_says_it_started_with_is_its_configuration(kuka, tmp_path):
    """Whatever was set since on the parameter server."""
    from kuka_control.ros.parameter_server import running

    calibrated = tmp_path / "arm.yaml"
    calibrated.write_text("robot: LBR7R800")
    for schema, values in ((RealTimeConfig, kuka), (RealTimeConfig, {**kuka, "dh_parameters": str(calibrated)})):
        said = running(parse(schema, values, "kuka/"), None, None)
        started, files = started_with({**kuka, "tcp_speed": 0.1, "running": said})
        assert not differences(*[fingerprint(each, files.__getitem__) for each in (values, started)])
        assert xmlrpc.client.loads(xmlrpc.client.dumps((said,)))[0][0] == said
    assert list(files) == [str(calibrated)] and len(files[str(calibrated)]) == 64
    assert started_with(kuka) == (kuka, {})


@pytest.mark.hazard(23)
@pytest.mark.parametrize("key", ["tool_length", "mounting", "center_line", "z_lower_limit", "tcp_speed", "joint_jerk"])
def test_what_differs_is_named_with_both_values(kuka, key):
    value = kuka.get(key, [0.0, 0.0, 0.0])
    here = fingerprint({**kuka, key: changed(value)}, str)
    (line,) = differences(fingerprint(kuka, str), here)
    assert key in line and str(value[0] if isinstance(value, list) else value) in line


def test_another_robot_and_another_calibration_differ(kuka):
    recorded = fingerprint(kuka, str)
    assert "LBR14R820" in " ".join(differences(recorded, fingerprint({**kuka, "robot": "LBR14R820"}, str)))
    contents = iter(["hash 1", "hash 2"])
    two = [fingerprint({**kuka, "dh_parameters": "/file"}, lambda _: next(contents)) for _ in range(2)]
    (line,) = differences(*two)
    assert "hash 1" in line and "hash 2" in line


def test_a_robot_at_another_address_is_said(kuka):
    here = {**kuka, "ip": "172.31.1.147", "port": 30001}
    assert not moved_away({"address": address(here)}, here)
    for there in ({"address": "127.0.0.1:30001"}, {"address": "172.31.1.147:30002"}, {}):
        sentence = moved_away(there, here)
        assert "172.31.1.147:30001" in sentence and there.get("address", "nothing") in sentence


@pytest.mark.parametrize("recorded", [None, {}, {"model": {}}, [], {"model": []}])
def test_a_recording_without_a_robot_fits_none(kuka, recorded):
    assert differences(recorded, fingerprint(kuka, str))
    assert differences(fingerprint(kuka, str), fingerprint({}, str))


def test_every_parameter_is_compared_or_left_out_on_purpose():
    fields = {field.name for schema in (RealTimeConfig, PtpConfig) for field in dataclasses.fields(schema)}
    assert fields >= KNOWN
    assert fields - KNOWN == LEFT_OUT == {
        "ip", "port", "time_out", "home_pos", "use_home_pos", "named_positions", "rate_joints", "rate_state",
        "rate_servo", "servo_law", "joints_thresh", "ptp_contact_torque", "flange_force_raw", "robot_server",
        "watchdog_brake", "watchdog_end", "compliance", "soft_stiffness", "soft_turning_stiffness", "soft_damping",
        "soft_force", "soft_moment", "soft_path", "admittance", "admittance_mass", "admittance_damping",
        "admittance_stiffness", "admittance_contact", "admittance_path",
    }  # fmt: skip


@pytest.mark.hazard(23)
def test_no_parameter_that_is_left_out_moves_a_joint_elsewhere_on_a_recorded_path(kuka):
    """The tool's path alone does not say where the elbow goes."""
    others = {
        "ip": "10.0.0.1", "port": 30002, "time_out": 0.5, "named_positions": "/another.yaml", "rate_joints": 50.0,
        "rate_state": 10.0, "rate_servo": 100.0, "servo_law": "lts", "use_home_pos": True,
        "ptp_contact_torque": 5.0, "flange_force_raw": True, "robot_server": "leap_rig", "watchdog_brake": 0.5,
        "watchdog_end": 20.0, "compliance": "soft", "soft_stiffness": 100.0, "soft_turning_stiffness": 10.0,
        "soft_damping": 0.5, "soft_force": 10.0, "soft_moment": 5.0, "soft_path": 0.1,
        "admittance": False, "admittance_mass": 9.0, "admittance_damping": 2000.0, "admittance_stiffness": 300.0,
        "admittance_contact": 1000.0, "admittance_path": 0.02,
        "home_pos": [-30.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0], "elbow_preference": 60.0,
    }  # fmt: skip

    def path(**changes):
        config = parse(RealTimeConfig, {**kuka, "robot_server": "leap_rig", **changes}, "kuka/")  # compliance needs it
        limits = line_limits(config, Rig.of(config, None, None))
        q = Rig.of(parse(RealTimeConfig, kuka, "kuka/")).home.q
        T = translation(0.0, 0.1, 0.05) @ limits.kinematics.forward(q)
        return np.array(plan_line(limits, q, T, 0.1).path)

    moved = {key for key, value in others.items() if not np.array_equal(path(**{key: value}), path())}
    assert moved == {"elbow_preference"} and others.keys() == (LEFT_OUT | moved) - {"joints_thresh"}
    assert moved <= KNOWN
