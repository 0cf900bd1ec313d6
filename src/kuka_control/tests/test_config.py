"""The parameters of the controllers: the files are good, each bad value is refused with a sentence that names it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from common.config import keys, parse
from common.errors import ConfigError, RigError
from common.poses import translation
from kuka_control.model.config import DhDeviations, PtpConfig, RealTimeConfig, neighbours
from kuka_control.model.rig import Rig

CONFIG = Path(__file__).parents[1] / "config"
FILES = {RealTimeConfig: CONFIG / "kuka_params_rt.yaml", PtpConfig: CONFIG / "kuka_params_ptp.yaml"}
schemas = pytest.mark.parametrize("schema", FILES, ids=lambda s: s.__name__)


def values(schema, **changes):
    return {**yaml.safe_load(FILES[schema].read_text()), **changes}


@schemas
def test_the_files_hold_good_defaults_for_every_key_and_nothing_else(schema):
    Rig.of(parse(schema, values(schema)))
    assert values(schema).keys() == {key.name for key in keys(schema)}


@schemas
def test_every_line_says_its_unit(schema):
    for line in FILES[schema].read_text().splitlines():
        if re.match(r"\w+:", line):
            assert re.search(r"# .*(\bm\b|\bNm?\b|\bkg\b|\bs\b|\bdeg\b|\bHz\b|m/s|no unit|fraction of)", line), line


OF_BOTH = [
    ("robot", "LBR7"), ("flange", "electric"), ("port", 0), ("center_line", [1, -1, 0.1]), ("center_line", [0, 0, 0]),
    ("opening_angle", 0.0), ("opening_angle", 180.0), ("z_lower_limit", 0.1), ("z_lower_limit", 0.6),
    ("z_upper_limit", 1.14), ("z_upper_limit", 0.2), ("z_upper_limit", 1.05), ("inner_sphere_limit", 0.4),
    ("inner_sphere_limit", 0.7), ("outer_sphere_limit", 0.8), ("tool_length", -0.001), ("time_out", 0.0),
    ("rate_state", 0), ("flange_force_raw", 1),
]  # fmt: skip
OF_ONE = {
    RealTimeConfig: [
        ("tcp_speed", 0.8), ("joint_speed", 1.1), ("rate_servo", 10), ("joint_acceleration", 0.9),
        ("joint_acceleration", 16.1), ("joint_jerk", 19.0), ("joint_jerk", 2001.0),
        *((key, share) for key in ("velocity_ptp_slow", "velocity_ptp_fast") for share in (0.0, 1.0)),
    ],
    PtpConfig: [("velocity_ptp", 0.0), ("velocity_ptp", 1.0), ("joints_thresh", -1)],
}  # fmt: skip


@schemas
def test_a_value_out_of_its_range_is_refused_by_name(schema):
    for key, value in OF_BOTH + OF_ONE[schema]:
        with pytest.raises(ConfigError) as error:
            parse(schema, values(schema, **{key: value}), "kuka/")
        assert all(key in fault for fault in error.value.faults), (value, error.value.faults)


@pytest.mark.parametrize(("robot", "outer", "highest"), [
    ("LBR7R800", 0.7, 1.04), ("LBR7R800", 0.79, 1.13), ("LBR14R820", 0.7, 1.06), ("LBR14R820", 0.79, 1.139),
])  # fmt: skip
def test_the_workspace_is_as_high_as_the_outer_sphere_or_1_14_m(robot, outer, highest):
    wide = values(PtpConfig, robot=robot, outer_sphere_limit=outer, use_home_pos=True)
    assert Rig.of(parse(PtpConfig, {**wide, "z_upper_limit": highest})).workspace.z_upper == highest
    with pytest.raises(ConfigError, match="z_upper_limit .* (top of the outer sphere|1.14)"):
        parse(PtpConfig, {**wide, "z_upper_limit": highest + 0.005})


def test_a_workspace_whose_middle_is_too_high_for_the_home_position_is_refused_with_the_cause():
    with pytest.raises(RigError, match="the workspace is too high"):
        Rig.of(parse(PtpConfig, values(PtpConfig, z_lower_limit=0.6, z_upper_limit=1.0)))


@schemas
def test_what_both_controllers_upload_and_load_may_stand_side_by_side(schema):
    other = PtpConfig if schema is RealTimeConfig else RealTimeConfig
    both = {**values(other), **values(schema), "ws_center": [0, 0, 0], "joints_home": [0] * 7}
    parse(schema, both, others=neighbours(schema))
    with pytest.raises(ConfigError, match="velocity is not a known key"):
        parse(schema, {**both, "velocity": 1}, others=neighbours(schema))


def test_a_home_of_ones_own():
    rig = Rig.of(parse(RealTimeConfig, values(RealTimeConfig, use_home_pos=True)))
    assert rig.home.q[0] == pytest.approx(-0.785398, abs=1e-6)
    turned = values(RealTimeConfig, use_home_pos=True, home_pos=[0, 30, 0, -80, 0, 70, 0])
    with pytest.raises(RigError, match="outside the workspace"):
        Rig.of(parse(RealTimeConfig, turned))


@pytest.mark.parametrize(
    ("schema", "preference", "calibrated"),
    [(RealTimeConfig, -35.0, False), (RealTimeConfig, 20.0, True), (PtpConfig, 20.0, False)],
)
def test_the_elbow_goes_where_the_parameter_prefers_it_and_home_keeps_it_up(schema, preference, calibrated):
    config = parse(schema, values(schema, elbow_preference=preference, center_line=[1, 0, 0]))
    deviations = DhDeviations(config.robot, "", "", *np.full((4, 7), 1e-3), None) if calibrated else None
    rig = Rig.of(config, deviations)
    q, T = rig.home.q, rig.home.T_base_tool
    np.testing.assert_allclose(q[2], 0.0, atol=1e-3)
    for way in 0.03 * np.sin(np.arange(1500) / 10.0):
        q = rig.kinematics.inverse(translation(0.0, 0.0, way) @ T, q).q
    end = rig.kinematics.inverse(rig.kinematics.forward(q), q)
    assert np.degrees(end.arm_angle) == pytest.approx(preference, abs=1.5)
    elbow_y = np.sin(q[1]) * np.sin(q[0])
    assert np.sign(round(elbow_y, 2)) == -np.sign(preference), "the arm reaches along x: its right is -y"


@schemas
def test_the_workspace_is_judged_even_where_single_values_are_out_of_range(schema):
    wrong = values(schema, outer_sphere_limit=0.9, center_line=[0, 0, 1], z_lower_limit=0.7, opening_angle=float("nan"))
    with pytest.raises(ConfigError) as caught:
        parse(schema, wrong, "kuka/")
    assert sorted(fault.split()[0] for fault in caught.value.faults) == [
        "kuka/center_line",
        "kuka/opening_angle",
        "kuka/outer_sphere_limit",
        "kuka/z_lower_limit",
    ]


def test_a_file_without_an_elbow_preference_means_up():
    short = values(RealTimeConfig)
    del short["elbow_preference"]
    assert parse(RealTimeConfig, short).elbow_preference == 0.0
    with pytest.raises(ConfigError, match="elbow_preference is 91"):
        parse(RealTimeConfig, values(RealTimeConfig, elbow_preference=91.0))


@schemas
def test_a_tool_transform_of_the_length_alone_is_the_same_rig_bit_for_bit(schema):
    plain = Rig.of(parse(schema, values(schema)))
    T = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.106, 0, 0, 0, 1]
    rig = Rig.of(parse(schema, values(schema, use_tool_transform=True, tool_transform=T, tool_length=0.0)))
    for name in ("q", "T_base_tool", "T_base_flange", "centre"):
        np.testing.assert_array_equal(getattr(rig.home, name), getattr(plain.home, name))
    np.testing.assert_array_equal(rig.T_flange_tool, plain.T_flange_tool)


@schemas
def test_a_file_without_tool_transform_and_mounting_means_a_length_on_the_floor(schema):
    short = values(schema)
    for key in ("use_tool_transform", "tool_transform", "mounting"):
        del short[key]
    first, second = (Rig.of(parse(schema, v)) for v in (short, values(schema)))
    np.testing.assert_array_equal(first.home.q, second.home.q)


@schemas
def test_a_tool_transform_that_mirrors_is_refused_only_if_it_is_used(schema):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0]).ravel().tolist()
    parse(schema, values(schema, tool_transform=mirror))
    with pytest.raises(ConfigError, match="kuka/tool_transform"):
        parse(schema, values(schema, tool_transform=mirror, use_tool_transform=True), "kuka/")


@schemas
@pytest.mark.parametrize("place", ["ceiling", "wall"])
@pytest.mark.parametrize("robot", ["LBR7R800", "LBR14R820"])
def test_the_files_for_ceiling_and_wall_have_a_home(schema, place, robot):
    file = CONFIG / f"{place}.yaml"
    changes = yaml.safe_load(file.read_text())
    assert changes.keys() < values(schema).keys()
    rig = Rig.of(parse(schema, values(schema, robot=robot, **changes)))
    np.testing.assert_allclose(rig.home.T_base_tool[:3, 2], -rig.mounting.up, atol=1e-9)
    for line in file.read_text().splitlines():
        assert line.startswith("#") or not line or re.search(r"# .*(\bm\b|\bdeg\b|no unit)", line), line


def test_an_arm_whose_mounting_leaves_no_home_is_refused():
    with pytest.raises(RigError, match=r"needs joint 6 .* on a ceiling far from the base"):
        Rig.of(parse(RealTimeConfig, values(RealTimeConfig, mounting=[180, 0, 0])))
    with pytest.raises(ConfigError, match="mounting"):
        parse(RealTimeConfig, values(RealTimeConfig, mounting=[181, 0, 0]))
