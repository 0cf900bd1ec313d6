"""The arm in the physics: it follows, does not sink, feels what it touches and holds, and stops when it presses."""

import dataclasses

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from common.rotations import rotation_from_zyx
from rig_simulation.devices.reflex.wire import POSITION, ModeCommand, TargetCommand
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.motions import leaves_torque_ranges
from rig_simulation.devices.sunrise.paths import JointMove
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_scene, read_urdf
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.parts import ArmJoints, HandPart
from rig_simulation.world.physics import World

DT = 1e-3
HOME = np.radians([-45, 30, 0, -80, 0, 70, 0])
GOAL_EVERY = 4


def solved(robot, T, q):
    """Returns joints near q that bring the flange to the pose T by damped least squares, or None."""
    for _ in range(200):
        error = pin.log6(pin.SE3(np.linalg.inv(robot.flange(q)) @ T)).vector
        if np.linalg.norm(error) < 1e-9:
            return q if robot.within_range(q) else None
        J = robot.jacobian(q, np.eye(4))
        step = J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(6), error)
        q = q + step * min(1.0, 0.2 / np.abs(step).max())
    return None


class Rig:
    """Arm and hand in a world, the arm at home over the table."""

    def __init__(self, scene="empty", mounting=(0.0, 0.0, 0.0), robot="LBR7R800", home=HOME, pairs=True):
        values = read_scene(scene) if isinstance(scene, str) else scene
        self.world = World(WorldDescription(robot, "MF_elektrisch", mounting, values))
        self.hand = HandPart()
        self.world.add(self.hand)
        self.opened = [servo.position for servo in self.hand.simulated.servos]
        model = Robot(read_urdf(robot, "MF_elektrisch"), mounting)
        self.arm = SimulatedArm(model, ArmSettings(servo_law="none"), ArmJoints(self.world, pairs))
        if np.any(home):
            self.go(home)

    def go(self, q, share=0.2):
        self.arm.start_motion(JointMove(self.arm.q, q, share * self.arm.robot.max_speed, self.arm.motion_acceleration))
        self.run(lambda: not self.arm.in_motion)

    def run(self, until, longest=30.0):
        for _ in range(round(longest / DT)):
            if until():
                return
            self.arm.step(DT)
        pytest.fail(f"nothing came of it in {longest} s; safety stop: {self.arm.safety_stop}")

    def wait(self, seconds):
        for _ in range(round(seconds / DT)):
            self.arm.step(DT)

    def move_tool(self, way, speed, until=lambda: False):
        """Streams goals that move the flange by `way` [m], shape (3,), at `speed` [m/s]."""
        if not self.arm.in_servo:
            self.arm.start_servo()
        T, q = self.arm.robot.flange(self.arm.goal), self.arm.goal
        steps = int(np.linalg.norm(way) / (speed * GOAL_EVERY * DT))
        for _ in range(steps):
            T[:3, 3] += np.array(way) / steps
            q = solved(self.arm.robot, T, q)
            self.arm.goal = q
            self.wait(GOAL_EVERY * DT)
            if until():
                return

    @property
    def lag(self):
        return np.abs(self.arm.q - self.world.data.qpos[:7]).max()


@pytest.mark.parametrize(
    ("robot", "mounting", "scene"),
    [
        ("LBR7R800", (0.0, 0.0, 0.0), "empty"),
        ("LBR14R820", (0.0, 0.0, 0.0), "empty"),
        ("LBR7R800", (180.0, 0.0, 0.0), "far"),
        ("LBR7R800", (0.0, 90.0, 0.0), "far"),
    ],
)
def test_an_arm_that_touches_nothing_follows_exactly_and_feels_nothing(robot, mounting, scene):
    rig = Rig(scene, mounting, robot, home=np.zeros(7))
    felt, lag = [], []

    def look():
        felt.append(np.abs(rig.arm.external_torques).max())
        lag.append(rig.lag)
        return not rig.arm.in_motion

    q = np.array([-0.7, 0.5, 0.2, -1.3, 0.1, 0.7, 0.5])
    speed = 0.3 * rig.arm.robot.max_speed
    rig.arm.start_motion(JointMove(rig.arm.q, q, speed, rig.arm.motion_acceleration))
    rig.run(look)
    assert max(felt) < 1.0, "the fingers swing a little"
    assert max(lag) < 1e-3
    rig.wait(2.0)
    assert rig.lag < 1e-6
    np.testing.assert_allclose(rig.arm.external_torques, np.zeros(7), atol=1e-3)
    held = rig.arm.robot.torques(q, np.zeros(7), np.zeros(7))
    np.testing.assert_allclose(rig.arm.measured_torques, held, atol=1e-2)


def test_a_load_on_the_flange_is_felt_as_force_and_borne_by_the_drives():
    rig = Rig()
    before = rig.arm.measured_torques
    body = rig.world.model.body("kuka/flange").id
    rig.world.data.xfrc_applied[body, :3] = [0.0, 0.0, -9.81]
    rig.wait(1.0)
    T = rig.arm.robot.flange(rig.arm.q)
    np.testing.assert_allclose(T[:3, :3] @ rig.arm.tool_force, [0.0, 0.0, -9.81], atol=0.1)
    assert abs(rig.arm.measured_torques[1]) > abs(before[1]) + 5.0
    assert rig.arm.safety_stop is None
    assert rig.lag < 2e-3


def test_resting_on_the_table_does_not_stop_the_arm_and_pressing_does():
    rig = Rig()
    rig.move_tool((0.0, 0.0, -0.5), 0.02, until=lambda: rig.arm.tool_force[2] < -5.0)
    rig.wait(0.5)
    assert rig.arm.safety_stop is None
    touching = {name for contact in rig.world.contacts() for name in contact["bodies"]}
    assert "table" in touching
    rig.move_tool((0.0, 0.0, -0.05), 0.02, until=lambda: rig.arm.safety_stop)
    rig.run(lambda: rig.arm.resting)
    assert "The external torque of joint 2 is" in rig.arm.safety_stop
    assert rig.arm.stops == 1
    assert rig.arm.robot.flange(rig.arm.q)[2, 3] > 0.10, "the table has stopped it"


def pressed_on_the_table(rig):
    rig.move_tool((0.0, 0.0, -0.5), 0.25, until=lambda: rig.arm.safety_stop)
    rig.run(lambda: rig.arm.resting)
    rig.wait(1.0)
    assert np.abs(rig.arm.external_torques).max() > 25.0


def test_an_arm_that_still_presses_is_not_released_but_can_back_off_and_then_continues():
    rig = Rig()
    pressed_on_the_table(rig)
    height = rig.arm.robot.flange(rig.arm.q)[2, 3]
    with pytest.raises(ValueError, match="persists"):
        rig.arm.release()
    rig.arm.back_off()
    rig.run(lambda: rig.arm.resting, 5.0)
    assert height < rig.arm.robot.flange(rig.arm.q)[2, 3] < height + 0.05, "only as far as it must"
    assert np.abs(rig.arm.external_torques).max() <= 12.5
    rig.arm.goal = rig.arm.q
    rig.arm.release()
    rig.move_tool((0.0, 0.0, 0.1), 0.1)
    rig.wait(1.0)
    assert rig.arm.safety_stop is None
    assert rig.arm.stops == 1
    assert rig.arm.robot.flange(rig.arm.q)[2, 3] > height + 0.08


def test_a_goal_that_stays_in_the_table_stops_the_arm_again_after_the_release():
    rig = Rig()
    pressed_on_the_table(rig)
    rig.arm.back_off()
    rig.run(lambda: rig.arm.resting, 5.0)
    rig.arm.release()
    rig.run(lambda: rig.arm.safety_stop is not None, 5.0)
    assert rig.arm.stops == 2


def test_a_planned_motion_into_the_table_is_paused_backs_off_along_its_way_and_ends_once_the_table_is_gone():
    rig = Rig()
    T = rig.arm.robot.flange(rig.arm.q)
    T[2, 3] -= 0.35
    goal = solved(rig.arm.robot, T, rig.arm.q)
    rig.arm.start_motion(JointMove(rig.arm.q, goal, 0.15 * rig.arm.robot.max_speed, rig.arm.motion_acceleration))
    rig.run(lambda: rig.arm.safety_stop is not None)
    rig.wait(1.0)
    pressed = rig.arm.q.copy()
    rig.arm.back_off()
    rig.wait(2.0)
    assert rig.arm.in_motion
    assert not rig.arm.v.any()
    assert np.abs(rig.arm.external_torques).max() <= 12.5
    assert np.linalg.norm(pressed - goal) < np.linalg.norm(rig.arm.q - goal) < np.linalg.norm(pressed - goal) + 0.1
    lower = read_scene("empty")
    lower["table"]["top"] = -0.5
    rig.world.set_scene(lower)
    rig.arm.release()
    rig.run(lambda: not rig.arm.in_motion)
    np.testing.assert_allclose(rig.arm.q, goal, atol=1e-9)
    assert rig.arm.safety_stop is None


def test_a_post_stands_fast_and_what_the_arm_feels_of_it_ends_a_guarded_motion():
    """Turned about joint 1 the hand meets it; the guard acts at 10 Nm, the safety stop at 25 Nm."""
    forces = {}
    for guard in (None, leaves_torque_ranges(np.array([(joint, -10.0, 10.0) for joint in range(7)]))):
        rig = Rig()
        post = {"position": [-0.05, 0.25], "radius": 0.03, "height": 1.0}
        rig.world.set_scene({**read_scene("empty"), "posts": {"one": post}})
        goal, greatest = HOME + np.radians([60, 0, 0, 0, 0, 0, 0]), 0.0
        move = JointMove(rig.arm.q, goal, 0.15 * rig.arm.robot.max_speed, rig.arm.motion_acceleration)
        rig.arm.start_motion(move, guard)
        for _ in range(4000):
            rig.arm.step(DT)
            touching = [c["force"] for c in rig.world.contacts() if "post/one" in c["bodies"]]
            greatest = max(greatest, sum(touching))
        assert touching, "it presses on"
        assert rig.arm.in_motion == (guard is None), "a safety stop only pauses a motion"
        forces[guard] = greatest
    guarded, plain = forces.pop(guard), forces.pop(None)
    assert 30.0 < guarded < 0.95 * plain, (guarded, plain)
    # An arm that is sent on while it still presses does not move.
    rig.arm.settings = dataclasses.replace(rig.arm.settings, torque_limit=np.inf)
    at = rig.arm.q
    rig.arm.start_motion(JointMove(at, goal, 0.15 * rig.arm.robot.max_speed, rig.arm.motion_acceleration), guard)
    rig.run(lambda: not rig.arm.in_motion, 0.1)
    np.testing.assert_allclose(rig.arm.q, at, atol=1e-4)


def test_a_blow_at_full_speed_neither_breaks_the_physics_nor_goes_through_the_table():
    rig = Rig()
    rig.move_tool((0.0, 0.0, -0.6), 0.7, until=lambda: rig.arm.safety_stop)
    rig.run(lambda: rig.arm.resting)
    rig.wait(1.0)
    assert all(contact["depth"] < 0.005 for contact in rig.world.contacts())
    assert rig.world.data.body("reflex/distal_1").xpos[2] > 0.04
    strongest = rig.world.model.jnt_actfrcrange[:7, 1]
    assert np.all(np.abs(rig.arm.external_torques) <= strongest + 1e-6)


def test_in_free_space_pairs_of_steps_follow_as_exactly_as_single_steps():
    single, pairs = Rig(pairs=False), Rig(pairs=True)
    for rig in (single, pairs):
        rig.move_tool((0.1, -0.05, 0.08), 0.2)
        rig.wait(0.5)
    assert pairs.world.steps == single.world.steps - single.world.steps % 2
    np.testing.assert_array_equal(pairs.arm.q, single.arm.q)
    np.testing.assert_allclose(pairs.world.data.qpos, single.world.data.qpos, atol=2e-5)
    np.testing.assert_allclose(pairs.arm.external_torques, single.arm.external_torques, atol=1e-3)


def test_in_contact_every_step_is_a_step_of_the_world():
    rig, lengths = Rig(), []

    def touched():
        lengths.append(rig.world.model.opt.timestep)
        return rig.arm.tool_force[2] < -5.0

    rig.move_tool((0.0, 0.0, -0.5), 0.02, until=touched)
    assert lengths[:10] == [2 * DT] * 10
    assert lengths[-1] == DT
    before = rig.world.steps
    rig.wait(0.1)
    assert rig.world.steps == before + 100


def test_the_world_takes_no_other_step_than_its_own():
    rig = Rig()
    with pytest.raises(ValueError):
        rig.arm.step(0.002)


def close_hand(rig, spool):
    """Closes the three fingers to the spool angle [rad], as the driver does over its wire."""
    hand = rig.hand.simulated
    hand.handle(ModeCommand((POSITION,) * 4))
    ticks = np.array([1, -1, 1]) * 1.42 * 1024 / (2 * np.pi) * spool
    hand.handle(TargetCommand((*(int(o + t) for o, t in zip(rig.opened, ticks)), rig.opened[3])))


@pytest.mark.parametrize("pairs", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_cup_is_grasped_lifted_weighed_and_put_down_again(pairs):
    rig = Rig("cup", pairs=pairs)
    place = np.array(rig.world.objects()["cup"].position)
    T = rig.arm.robot.flange(rig.arm.q)
    # The grip is in the middle between thumb and fingers, 13 mm beside the flange's axis; 0.15 m beyond the flange.
    grip = T @ np.array([-0.013, 0.0, 0.15, 1.0])
    above = np.add(place, [0.0, 0.0, 0.20]) - grip[:3]
    rig.move_tool(above, 0.1)
    rig.move_tool((0.0, 0.0, -0.18), 0.1)
    rig.wait(1.0)
    assert rig.arm.safety_stop is None
    close_hand(rig, 2.3)
    rig.wait(3.0)
    assert any(name.startswith("reflex/") for name in rig.world.objects()["cup"].touches)
    rig.move_tool((0.0, 0.0, 0.15), 0.1)
    rig.wait(1.0)
    held = rig.world.objects()["cup"]
    assert held.clearance > 0.13
    assert "table" not in held.touches
    weight = rig.arm.robot.flange(rig.arm.q)[:3, :3] @ rig.arm.tool_force
    assert weight[2] == pytest.approx(-9.81 * read_scene("cup")["objects"]["cup"]["mass"], abs=0.1)
    rig.wait(20.0)
    assert rig.world.objects()["cup"].clearance > max(0.125, held.clearance - 0.001), "friction holds it"
    rig.move_tool((0.0, 0.0, -0.15), 0.1)
    close_hand(rig, 0.3)
    rig.wait(3.0)
    rig.move_tool((0.0, 0.0, 0.15), 0.1)
    rig.wait(1.0)
    down = rig.world.objects()["cup"]
    assert down.touches == ("table",)
    assert abs(down.clearance) < 1e-3, "it stands"


def test_an_arm_that_runs_riot_among_the_objects_always_gets_free_again():
    rng = np.random.default_rng(0)
    rig = Rig("objects")
    rig.arm.start_servo()
    upright = rig.arm.robot.flange(HOME)
    for _ in range(8):
        T = upright.copy()
        T[:3, 3] = rng.uniform([0.19, -0.69, 0.14], [0.69, -0.19, 0.40])
        T[:3, :3] = T[:3, :3] @ rotation_from_zyx(*rng.uniform(-0.5, 0.5, 3))
        q = solved(rig.arm.robot, T, rig.arm.q)
        if q is None:
            continue
        close_hand(rig, rng.uniform(0.3, 3.2))
        for goal in np.linspace(rig.arm.q, q, int(np.abs(q - rig.arm.q).max() / 0.002) + 2):
            rig.arm.goal = goal
            rig.wait(GOAL_EVERY * DT)
            if rig.arm.safety_stop:
                break
        if rig.arm.safety_stop:
            rig.wait(0.5)
            rig.arm.back_off()
            rig.run(lambda: rig.arm.resting, 20.0)
            rig.arm.goal = rig.arm.q
            rig.arm.release()
    assert rig.arm.stops > 0, "it was rough enough"
    assert np.all(np.isfinite(rig.world.data.qpos))


@pytest.fixture(autouse=True)
def no_log_file():
    """Keeps MuJoCo's warnings out of a file in the present folder."""
    mujoco.set_mju_user_warning(lambda _: None)
