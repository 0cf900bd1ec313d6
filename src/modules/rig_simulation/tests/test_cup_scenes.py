"""The scenes of rounds: valid, drawn by a seed, and over the whole range that they promise."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from rig_simulation.files import read_scene
from rig_simulation.operator.cup_scenes import CENTRE_M, CUP, LIGHTS, REACH_M, TOPS_M, cup_scene
from rig_simulation.world.model import WorldDescription, build_model
from rig_simulation.world.scene import scene_from


def test_a_seed_makes_one_scene_and_the_given_one_stays():
    given = read_scene("cup")
    assert cup_scene(given, 3) == cup_scene(given, 3) != cup_scene(given, 4)
    assert given == read_scene("cup")


def test_the_scenes_fill_the_range():
    scenes = [scene_from(cup_scene(read_scene("cup"), seed)) for seed in range(300)]
    drawn = np.array([[*one.objects[CUP].position, one.table.top, one.light, one.objects[CUP].yaw] for one in scenes])
    low = [CENTRE_M[0] - REACH_M, CENTRE_M[1] - REACH_M, TOPS_M[0], LIGHTS[0], -180.0]
    high = [CENTRE_M[0] + REACH_M, CENTRE_M[1] + REACH_M, TOPS_M[1], LIGHTS[1], 180.0]
    part = (drawn - low) / np.subtract(high, low)
    assert (part >= 0.0).all() and (part <= 1.0).all()
    assert (part.min(axis=0) < 0.03).all() and (part.max(axis=0) > 0.97).all()
    assert np.abs(np.corrcoef(drawn.T) - np.eye(5)).max() < 0.2


def test_light_changes_the_lights_and_nothing_else():
    def model(**more):
        scene = {**read_scene("cup"), **more}
        return build_model(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), scene))

    bright, dark, shipped = model(light=1.0), model(light=0.5), model()
    assert_allclose(dark.light_diffuse, 0.5 * bright.light_diffuse)
    assert_allclose(dark.vis.headlight.ambient, 0.5 * bright.vis.headlight.ambient)
    assert_allclose(dark.vis.headlight.diffuse, 0.5 * bright.vis.headlight.diffuse)
    assert_allclose(dark.geom_rgba, bright.geom_rgba)
    assert_allclose(shipped.light_diffuse, bright.light_diffuse)
