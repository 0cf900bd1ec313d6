"""The operator against a wall of objects, and the obstacles by which the collision guard knows them."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from rig_simulation.files import SOURCE_TREE, read_scene
from rig_simulation.operator.wall import MOVES, WallView, WallVisit
from rig_simulation.world.scene import Cuboid, scene_from, table_pose

START = np.array([0.4, -0.4, 0.4])


def test_the_obstacles_are_the_objects_of_the_scene():
    scene = scene_from(read_scene("wall"))
    obstacles = yaml.safe_load((SOURCE_TREE / "config" / "wall_obstacles.yaml").read_text())
    assert set(obstacles) == {"stand", *scene.objects}
    T = table_pose(scene.table)
    for name, thing in scene.objects.items():
        found = obstacles[name]
        middle = T @ (*thing.position, thing.height / 2.0, 1.0)
        np.testing.assert_allclose(found["position"], middle[:3], atol=1e-3)
        assert found["rpy"] == [0, 0, scene.table.yaw + thing.yaw]
        if isinstance(thing, Cuboid):
            np.testing.assert_allclose(found["size"], thing.size)
        else:
            assert (found["kind"], found["radius"], found["height"]) == ("cylinder", thing.radius, thing.height)
    np.testing.assert_allclose(obstacles["stand"]["size"][:2], scene.table.size)


def visit(end=START, distance=0.031, scale=0.0):
    """Runs a visit whose tool ends at a position, and whose guard reports these; returns it and its last step."""
    operator, names, now = WallVisit(), [], 0.0
    while now < 60.0:
        away = 2.0 < now < 6.0
        view = WallView(START if now < 5.0 else end, now > 1.0, distance if away else 0.2, 0.03, scale if away else 1.0)
        result = operator.step(view, now)
        names.append(result.step)
        if result.over:
            return operator, names, result
        now += 0.1
    raise AssertionError("the visit did not end")


def test_the_hand_goes_to_the_wall_along_it_and_back_and_the_arm_is_judged():
    operator, names, result = visit()
    assert list(dict.fromkeys(names)) == ["wait", *(move[0] for move in MOVES), "done"] and not result.failure
    assert operator.smallest == 0.031 and operator.held == pytest.approx(3.9, abs=0.2)


@pytest.mark.parametrize(
    "changes, reason",
    [({"distance": 0.02}, "20 mm"), ({"scale": 1.0}, "did not act"), ({"end": START + 0.1}, "way back")],
)
def test_a_guard_that_fails_is_named(changes, reason):
    assert reason in visit(**changes)[2].failure


def test_an_arm_that_never_follows_ends_the_visit():
    operator = WallVisit()
    view = WallView(START, False, 0.2, 0.03, 1.0)
    assert not operator.step(view, 0.0).over and "follow" in operator.step(view, 31.0).failure
