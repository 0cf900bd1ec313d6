"""Objects in the simulated world: they stand, fall, can be put back, and do the same thing each time."""

import mujoco
import numpy as np
import pytest

from common.errors import ConfigError, DeviceError
from rig_simulation.files import read_scene
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.physics import Part, World
from rig_simulation.world.scene import scene_from


class Still(Part):
    """Holds all joints of the robot where they are, at the angles of `q` if there are any."""

    def __init__(self, q=None):
        self.q = q

    def bind(self, world):
        self.data, self.count = world.data, 15
        if self.q is not None:
            self.data.qpos[: len(self.q)] = self.q
        self.held = self.data.qpos[: self.count].copy()

    def before_step(self):
        self.data.qpos[: self.count] = self.held
        self.data.qvel[: self.count] = 0.0


def world_of(scene, seed=0, mounting=(0.0, 0.0, 0.0), q=None):
    """A world with a robot that stands still."""
    values = read_scene(scene) if isinstance(scene, str) else scene
    world = World(WorldDescription("LBR7R800", "MF_elektrisch", mounting, values), seed)
    world.add(Still(q))
    return world


def run(world, seconds):
    for _ in range(round(seconds / world.timestep)):
        world.step()


def test_objects_come_to_rest_where_the_scene_puts_them():
    world = world_of("objects")
    before = world.objects()
    run(world, 2.0)
    for name, state in world.objects().items():
        np.testing.assert_allclose(state.position[:2], before[name].position[:2], atol=1e-4)
        assert state.speed < 1e-4
        assert abs(state.clearance) < 5e-4
        assert state.touches == ("table",)


@pytest.mark.parametrize("mounting", [(180.0, 0.0, 0.0), (0.0, 90.0, 0.0)])
def test_gravity_of_the_objects_does_not_care_how_the_arm_is_mounted(mounting):
    world = world_of("far", mounting=mounting)
    run(world, 1.0)
    assert abs(world.objects()["cup"].clearance) < 5e-4


def test_a_standing_cup_does_not_creep():
    """At most 10 um and 20 urad in a minute."""
    world = world_of("cup")
    run(world, 1.0)
    before = world.objects()["cup"]
    run(world, 6.0)
    after = world.objects()["cup"]
    np.testing.assert_allclose(after.position, before.position, atol=1e-6)
    np.testing.assert_allclose(after.quaternion, before.quaternion, atol=1e-6)


def test_a_cup_is_hollow():
    world = world_of("objects")
    run(world, 0.2)
    cup, ball = world.data.joint("object/cup").qpos, world.data.joint("object/ball")
    pea = 0.02
    world.model.geom_size[world.model.geom("object/ball/ball").id, 0] = pea
    ball.qpos[:3] = cup[:3] + [0.0, 0.0, 0.10]
    run(world, 1.0)
    state = world.objects()["ball"]
    assert state.touches == ("object/cup",)
    assert state.clearance < 0.01


def test_an_object_that_is_pushed_over_the_edge_falls_to_the_floor_and_reset_brings_it_back():
    world = world_of("objects")
    run(world, 0.5)
    before = world.objects()["box"].position
    world.data.joint("object/box").qpos[:3] += [0.0, 0.0, 0.3]
    world.data.joint("object/box").qpos[:2] = [2.0, 0.0]
    run(world, 2.0)
    fallen = world.objects()["box"]
    assert fallen.touches == ("floor",)
    assert fallen.clearance < -0.7
    world.reset()
    run(world, 1.0)
    np.testing.assert_allclose(world.objects()["box"].position, before, atol=1e-4)
    assert world.objects()["box"].touches == ("table",)


def test_a_hand_in_the_way_refuses_the_reset_and_nothing_changes():
    world = world_of("cup", q=np.radians([-45, 30, 0, -80, 0, 70, 0]))
    values = read_scene("objects")
    values["table"].update(centre=world.data.body("reflex/base_link").xpos[:2].tolist())
    values["objects"] = {"box": {**values["objects"]["box"], "position": [0.0, 0.0], "size": [0.1, 0.1, 0.3]}}
    before = world.data.qpos.copy()
    with pytest.raises(ValueError):
        world.set_scene(values)
    np.testing.assert_array_equal(world.data.qpos, before)
    assert world.loads == 1
    assert world.description.scene == read_scene("cup")


def test_a_change_of_scene_keeps_the_robot():
    world = world_of("cup")
    held = np.linspace(-0.5, 0.5, 7)
    world.data.qpos[:7] = held
    run(world, 0.1)
    held = world.data.qpos[:15].copy()
    world.set_scene(read_scene("objects"))
    assert world.loads == 2
    assert set(world.objects()) == set(scene_from(read_scene("objects")).objects)
    np.testing.assert_array_equal(world.data.qpos[:15], held)
    run(world, 1.0)
    assert all(state.touches == ("table",) for state in world.objects().values())


def test_a_faulty_scene_changes_nothing():
    world = world_of("cup")
    with pytest.raises(ConfigError):
        world.set_scene({"table": 1})
    assert set(world.objects()) == {"cup"}


def test_the_same_seed_scatters_alike_and_another_one_otherwise():
    def places(seed):
        world = world_of("scattered", seed)
        first = world.data.qpos.copy()
        world.reset()
        return first, world.data.qpos.copy()

    first, second = places(3)
    np.testing.assert_array_equal(first, places(3)[0])
    np.testing.assert_array_equal(second, places(3)[1])
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, places(4)[0])


@pytest.mark.parametrize("seed", range(5))
def test_scattered_objects_keep_to_their_area_and_do_not_overlap(seed):
    world = world_of("scattered", seed)
    exact = world_of("objects").objects()
    for name, state in world.objects().items():
        away = np.array(state.position[:2]) - exact[name].position[:2]
        assert np.linalg.norm(away) <= 0.05 * np.sqrt(2.0) + 1e-9
    run(world, 0.5)
    assert all(state.touches == ("table",) for state in world.objects().values())


def test_a_scene_without_room_is_refused():
    values = read_scene("cup")
    values["objects"]["other"] = dict(values["objects"]["cup"])
    with pytest.raises(ValueError):
        world_of(values)


def test_contacts_bear_the_weight():
    world = world_of("objects")
    run(world, 1.0)
    for name, shape in scene_from(read_scene("objects")).objects.items():
        up = sum(
            c["force"] * c["normal"][2] * (1.0 if c["bodies"][1] == f"object/{name}" else -1.0)
            for c in world.contacts()
            if f"object/{name}" in c["bodies"]
        )
        assert up == pytest.approx(9.81 * shape.mass, rel=0.02)


def test_physics_that_goes_astray_says_so():
    world = world_of("cup")
    world.data.qvel[20] = 1e12
    with pytest.raises(DeviceError):
        world.step()


@pytest.fixture(autouse=True)
def no_log_file():
    """Keeps MuJoCo's warnings out of a file in the present folder."""
    mujoco.set_mju_user_warning(lambda _: None)
