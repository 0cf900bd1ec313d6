"""Views of the simulated world: forces, shapes, films, and the programs that show it."""

from __future__ import annotations

import shutil
import signal
from types import SimpleNamespace

import cv2
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import clock
from common.errors import DeviceError
from common.poses import inverse
from rig_simulation.control_port import ControlClient
from rig_simulation.files import read_scene
from rig_simulation.recording import record
from rig_simulation.recording.display import (
    LONGEST_M,
    METRES_PER_NEWTON,
    Arrow,
    add_arrows,
    arrows,
    base_pose,
    beyond,
    pair_forces,
    shapes,
)
from rig_simulation.recording.films import ContactSheet, FilmError, Mp4, film_for, with_lines
from rig_simulation.world.model import WorldDescription, build_model
from simulated.clock import virtual_time

TABLE = read_scene("objects")["table"]


def contact(first, second, force=2.0, position=(0.1, 0.2, 0.3), normal=(0.0, 0.0, -1.0)):
    return {"bodies": [first, second], "force": force, "position": list(position), "normal": list(normal), "depth": 0.0}


@pytest.mark.parametrize(
    ("first", "second", "normal"),
    [("object/cup", "table", (0.0, 0.0, -1.0)), ("table", "object/cup", (0.0, 0.0, 1.0))],
)
def test_the_table_pushes_the_cup_up_in_whatever_order_they_are_named(first, second, normal):
    (pair,) = pair_forces([contact(first, second, normal=normal)])
    assert pair.bodies == ("object/cup", "table")
    np.testing.assert_allclose(pair.force, [0.0, 0.0, 2.0])
    (arrow,) = arrows([pair])
    np.testing.assert_allclose(arrow.tail, [0.1, 0.2, 0.3], err_msg="it rises out of the cup")
    np.testing.assert_allclose(arrow.tip, [0.1, 0.2, 0.3 + 2.0 * METRES_PER_NEWTON])
    assert not arrow.by_robot and not pair.by_robot


@given(st.lists(st.tuples(st.floats(0.1, 1.0), st.floats(-0.5, 0.5)), min_size=1, max_size=8))
def test_contacts_of_a_finger_are_one_arrow_that_ends_where_they_press(listed):
    pressing = [
        contact("reflex/distal_1", "object/cup", newtons, (newtons, 0.0, 0.0), (np.cos(angle), np.sin(angle), 0.0))
        for newtons, angle in listed
    ]
    (arrow,) = arrows(pair_forces(pressing))
    together = np.sum([one["force"] * np.array(one["normal"]) for one in pressing], axis=0)
    length = min(METRES_PER_NEWTON * np.linalg.norm(together), LONGEST_M)
    np.testing.assert_allclose(arrow.tip - arrow.tail, length * together / np.linalg.norm(together), atol=1e-9)
    np.testing.assert_allclose(arrow.tip, pair_forces(pressing)[0].position, atol=1e-9)
    assert arrow.by_robot


def test_arrows_have_a_longest_length_and_forces_that_are_tiny_or_cancel_have_none():
    contacts = [contact("object/cup", "reflex/distal_1", force=500.0), contact("object/cup", "table", 0.001)]
    opposite = [contact("object/cup", "object/box", normal=(x, 0.0, 0.0)) for x in (1.0, -1.0)]
    (arrow,) = arrows(pair_forces(contacts + opposite))
    assert np.linalg.norm(arrow.tip - arrow.tail) == pytest.approx(LONGEST_M)
    assert arrow.by_robot


@given(st.lists(st.tuples(st.sampled_from(["table", "reflex/distal_1", "object/ball"]), st.floats(0.1, 50.0))))
def test_pairs_bear_what_their_contacts_bear(listed):
    contacts = [contact("object/cup", name, force, (force, 0.0, 0.0)) for name, force in listed]
    pairs = pair_forces(contacts)
    assert len(pairs) == len({name for name, _ in listed})
    assert sum(pair.newtons for pair in pairs) == pytest.approx(sum(force for _, force in listed))
    for pair in pairs:
        forces = [force for name, force in listed if name in pair.bodies]
        assert min(forces) - 1e-9 <= pair.position[0] <= max(forces) + 1e-9


@pytest.fixture(scope="module", params=[(0.0, 0.0, 0.0), (0.0, 90.0, 0.0)], ids=["floor", "wall"])
def world(request):
    """Model and state of a world with one object of each kind, on the floor and on a wall."""
    model = build_model(WorldDescription("LBR7R800", "MF_elektrisch", request.param, read_scene("objects")), False)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def test_shapes_are_where_the_physics_has_them(world):
    model, data = world
    found = shapes(model, data)
    assert {shape.body for shape in found} == {
        "table", "object/cup", "object/box", "object/ball", "object/cylinder", "object/bottle",
    }  # fmt: skip
    (table,) = [shape for shape in found if shape.body == "table"]
    np.testing.assert_allclose(table.size, [*TABLE["size"], 0.03])
    T_world_base = base_pose(data)
    T_world_table = T_world_base @ table.T_base_shape
    np.testing.assert_allclose(T_world_table[:3, 3], [*TABLE["centre"], TABLE["top"] - 0.015], atol=1e-9)
    np.testing.assert_allclose(T_world_table[2, :3], [0.0, 0.0, 1.0], atol=1e-9)
    (ball,) = [shape for shape in found if shape.body == "object/ball"]
    np.testing.assert_allclose(ball.size, 3 * [0.068])
    np.testing.assert_allclose(
        (inverse(T_world_base) @ [*data.body("object/ball").xpos, 1.0])[:3], ball.T_base_shape[:3, 3]
    )
    (neck, body) = sorted((shape for shape in found if shape.body == "object/bottle"), key=lambda s: s.size[0])
    np.testing.assert_allclose(neck.size, [0.028, 0.028, 0.06])
    np.testing.assert_allclose(body.size, [0.066, 0.066, 0.14])


def test_labels_stand_beyond_the_farthest_point(world):
    model, data = world
    up = inverse(base_pose(data))[:3, 2]
    bottle = [shape for shape in shapes(model, data) if shape.body == "object/bottle"]
    label = base_pose(data) @ [*beyond(bottle, up, 0.04), 1.0]
    middle = data.body("object/bottle").xpos
    np.testing.assert_allclose(label[:3], [*middle[:2], middle[2] + 0.10 + 0.04], atol=1e-9)


def test_arrows_fill_a_scene_but_never_more(world):
    model, _ = world
    scene = mujoco.MjvScene(model, maxgeom=3)
    shown = arrows(pair_forces([contact("object/cup", f"reflex/distal_{i}") for i in range(5)]))
    add_arrows(scene, shown)
    assert (scene.ngeom, len(shown)) == (3, 5)


ORTHOGRAPHIC = """
<mujoco>
  <visual><global offwidth="200" offheight="200"/></visual>
  <worldbody>
    <light pos="0 -3 0" dir="0 1 0"/>
    <camera name="ahead" pos="0 -2 0" xyaxes="1 0 0 0 0 1" orthographic="true" fovy="1"/>
  </worldbody>
</mujoco>"""


def test_an_arrow_is_drawn_from_its_tail_to_its_tip():
    from mujoco.egl import GLContext

    model = mujoco.MjModel.from_xml_string(ORTHOGRAPHIC)
    data, camera, drawn = mujoco.MjData(model), mujoco.MjvCamera(), np.zeros((200, 200, 3), np.uint8)
    mujoco.mj_forward(model, data)
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    scene = mujoco.MjvScene(model, maxgeom=10)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    add_arrows(scene, [Arrow(np.array([0.0, 0.0, -0.1]), np.array([0.0, 0.0, 0.3]), True)])
    screen = GLContext(200, 200)
    screen.make_current()
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    whole = mujoco.MjrRect(0, 0, 200, 200)
    mujoco.mjr_render(whole, scene, context)
    mujoco.mjr_readPixels(drawn, None, whole, context)
    context.free()
    screen.free()
    heights = (np.flatnonzero(drawn.max(axis=(1, 2)) > 20)[[0, -1]] - 100) / 200
    np.testing.assert_allclose(heights, [-0.1, 0.3], atol=0.015)


def image(grey):
    return np.full((60, 80, 3), grey, np.uint8)


def frames_of(path):
    video = cv2.VideoCapture(str(path))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1].mean())
    return frames


def test_a_film_has_the_times_of_its_images(tmp_path):
    film = Mp4(tmp_path / "a.mp4", 10.0)
    for time, grey in ((5.0, 0), (5.1, 100), (5.11, 255), (5.5, 200)):
        film.add(image(grey), time)
    film.close()
    np.testing.assert_allclose(frames_of(tmp_path / "a.mp4"), [0, 100, 100, 100, 100, 200], atol=12)


def test_a_film_ends_while_there_is_room_for_its_index(tmp_path, monkeypatch):
    film = Mp4(tmp_path / "a.mp4", 10.0)
    for i in range(5):
        film.add(image(50 * i), 0.1 * i)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10**6))
    with pytest.raises(FilmError):
        film.add(image(0), 0.5)
    film.close()
    assert len(frames_of(tmp_path / "a.mp4")) == 5


@pytest.mark.parametrize("count", [1, 5, 12, 24, 1000])
def test_a_contact_sheet_covers_the_whole_time_however_long_it_was(tmp_path, count):
    sheet = ContactSheet(tmp_path / "a.png")
    for i in range(count):
        sheet.add(image(round(255 * (i + 1) / count)), 0.1 * i)
    sheet.close()
    shown = cv2.imread(str(tmp_path / "a.png"))
    rows = min(-(-count // 4), 3)
    assert shown.shape == (30 * rows, 160, 3)
    cells = [shown[30 * r + 15, 40 * c + 20, 0] for r in range(rows) for c in range(4)][: min(count, 12)]
    assert list(cells) == sorted(cells)
    assert cells[-1] > 215 or count == 1
    assert cells[0] < 60 or count < 5


def test_text_is_written_into_a_copy():
    before = image(0)
    assert with_lines(before, ["1.0 s"]).max() > 200
    assert before.max() == 0


@pytest.mark.parametrize(("name", "sentence"), [("a.gif", ".mp4"), ("none/a.mp4", "folder"), ("a", ".png")])
def test_files_that_cannot_be_are_refused(tmp_path, name, sentence):
    with pytest.raises(FilmError, match=sentence):
        film_for(tmp_path / name, 20.0)


WORLD_PORT = "26000"


@pytest.fixture
def recorder(virtual_graph, monkeypatch):
    """Starts the recorder in virtual time, with images of 160 by 120."""
    from mujoco import egl

    monkeypatch.setattr(mujoco.renderer.gl_context, "GLContext", egl.GLContext)
    monkeypatch.setattr(record.os, "nice", lambda _: None)
    return lambda *files: virtual_graph.run(
        "rig_simulation",
        "record.py",
        *map(str, files),
        "--port",
        WORLD_PORT,
        "--size",
        "160",
        "120",
        "__name:=recorder",
    )


@pytest.fixture
def running_world(virtual_graph):
    """A running world in virtual time."""
    from simulated.hand_wire import HandNetwork

    names = ("--port", "--control-port", "--hand-port", "--hand-control-port")
    free = [word for name in names for word in (name, "0")]
    with HandNetwork():
        node = virtual_graph.run("rig_simulation", "world.py", *free, "--world-port", WORLD_PORT)
        clock.sleep(0.1)
        yield node


@pytest.mark.ros
def test_the_recorder_films_a_running_world_and_its_end(recorder, running_world, tmp_path):
    film, sheet = tmp_path / "a.mp4", tmp_path / "a.png"
    program = recorder(film, sheet)
    clock.sleep(1.0)
    ControlClient("127.0.0.1", int(WORLD_PORT)).ask("set_scene", scene="empty")
    clock.sleep(1.0)
    running_world.send_signal(signal.SIGINT)
    assert program.wait(1.0) == 0 and "images in" in program.log, program.log
    brightness = frames_of(film)
    assert len(brightness) == pytest.approx(40, abs=2)
    assert min(brightness) > 20.0, "no image is empty"
    assert cv2.imread(str(sheet)).mean() > 10.0


@pytest.mark.ros
def test_the_film_continues_after_a_world_that_hangs(running_world):
    view = record.FilmView(ControlClient("127.0.0.1", int(WORLD_PORT), 1.0), (32, 24), (150.0, -20.0, 1.6))
    assert record._follow(view, clock.Event())
    running_world.send_signal(signal.SIGSTOP)
    before, began = view.time, clock.monotonic()
    with pytest.raises(DeviceError):
        view.follow()
    assert clock.monotonic() - began == pytest.approx(1.0, abs=0.1)
    clock.Timer(1.5, running_world.send_signal, [signal.SIGCONT]).start()
    assert record._follow(view, clock.Event()) and view.time > before
    assert clock.monotonic() - began == pytest.approx(2.5, abs=0.1)


def test_a_world_that_hangs_for_too_long_ends_the_film_with_a_sentence():
    class View:
        time = 12.34

        def follow(self):
            raise DeviceError("It does not answer: timed out.")

    with virtual_time():
        began = clock.monotonic()
        with pytest.raises(DeviceError, match=r"The film stops at 12\.3 s of the world: It does not answer"):
            record._follow(View(), clock.Event())
        assert clock.monotonic() - began == pytest.approx(20.0, abs=0.5)


@pytest.mark.ros
def test_the_recorder_ends_when_it_is_interrupted(recorder, running_world, tmp_path):
    program = recorder(tmp_path / "a.mp4")
    clock.sleep(0.5)
    program.send_signal(signal.SIGINT)
    assert program.wait(0.1) == 0, program.log
    assert len(frames_of(tmp_path / "a.mp4")) == pytest.approx(10, abs=2)
