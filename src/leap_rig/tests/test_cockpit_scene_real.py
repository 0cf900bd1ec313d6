"""The server of the cockpit's scene: on this machine alone, deaf to pages, and its nodes as viser has them."""

import contextlib
import math
import threading

import msgspec
import numpy as np
import pytest
import websockets.sync.client
from viser._messages import RemoveSceneNodeMessage, ShareUrlRequest, ViewerCameraMessage

from leap_rig.cockpit.markers import MarkerStore
from leap_rig.cockpit.scene import SceneServer
from rig_description.urdf import urdf
from rig_simulation.files import read_mesh

pytestmark = pytest.mark.real
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
FIXED = [("kuka/base_frame", "kuka/link_0"), ("kuka/link_7", "kuka/flange"), ("kuka/flange", "reflex/base_link")]
LINKS = [(f"kuka/link_{n - 1}", f"kuka/link_{n}") for n in range(1, 8)]
OF_HAND = [
    *((f"reflex/{a}", f"reflex/{b}") for a, b in (("base_link", "swivel_1"), ("base_link", "swivel_2"))),
    *((f"reflex/{a}", f"reflex/{b}") for a, b in (("swivel_1", "proximal_1"), ("swivel_2", "proximal_2"))),
    *((f"reflex/{a}", f"reflex/{b}") for a, b in (("base_link", "proximal_3"), ("proximal_1", "distal_1"))),
    *((f"reflex/{a}", f"reflex/{b}") for a, b in (("proximal_2", "distal_2"), ("proximal_3", "distal_3"))),
]


@pytest.fixture
def scene():
    scene = SceneServer()
    yield scene
    scene.close()


@pytest.fixture
def robot(scene):
    scene.set_robot("", urdf("LBR7R800", "MF_elektrisch"), read_mesh)
    for parent, child in (*FIXED, *LINKS, *OF_HAND):
        scene.put_transform(parent, child, STILL, 0.0)
    scene.update(0.0)
    return scene


def handle(scene, name):
    return scene._server.scene.get_handle_by_name(name)


def sent(scene):
    """How many messages were made for pages so far."""
    return scene._server._websock_server.get_message_buffer().message_counter


def test_it_listens_on_this_machine_alone(scene):
    sockets = [scene.address[0]]
    assert sockets == ["127.0.0.1"] and scene.port > 0 and scene.viewers == 0
    assert b"display: none" in scene.page and scene.page.count(b"</head>") == 1


class TestPage:
    @contextlib.contextmanager
    def connect(self, scene):
        """A page that reads whatever comes."""
        host, port = scene.address
        with websockets.sync.client.connect(
            f"ws://{host}:{port}", subprotocols=["viser-v1.1.1"], max_size=None, close_timeout=2.0
        ) as page:
            reads = threading.Thread(target=lambda: [None for _ in page], daemon=True)
            reads.start()
            yield page

    def test_that_asks_for_a_tunnel_or_removes_things_has_no_effect(self, robot, monkeypatch, wait_until):
        asked, removal = [], RemoveSceneNodeMessage("/robot:/measured")
        monkeypatch.setattr(robot._server, "request_share_url", lambda *_: asked.append(1))
        camera = ViewerCameraMessage(
            wxyz=(1.0, 0.0, 0.0, 0.0), position=(0.0, math.nan, 0.0), fov=0.0, near=0.1, far=9.0, image_height=0,
            image_width=0, look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0),
        )  # fmt: skip
        messages = [message.as_serializable_dict([]) for message in (ShareUrlRequest(), removal, camera)]
        with self.connect(robot) as page:
            for message in messages:
                page.send(msgspec.msgpack.encode(message))
            wait_until(lambda: robot.viewers == 1, 20.0, "the page's camera")
            robot.update(1.0)  # a camera of no numbers is no fault
            page.send(msgspec.msgpack.encode({**messages[-1], "position": ["a", "b", "c"]}))
            wait_until(lambda: robot.viewers == 0, 20.0, "the end of a page that sends no numbers")
            assert not asked and handle(robot, "/robot:/measured") is not None

    def test_that_sends_no_message_harms_no_other(self, scene):
        with self.connect(scene) as bad, self.connect(scene) as good:
            bad.send(b"\xff\xff no message")
            scene.put_transform("a", "b", STILL, 0.0)
            scene.show_axes("b", 0.1)
            assert good.ping().wait(20.0)


class TestRobot:
    def test_is_hidden_until_all_its_joints_are_known(self, scene):
        scene.set_robot("", urdf("LBR7R800", "MF_elektrisch"), read_mesh)
        scene.update(0.0)
        assert not handle(scene, "/robot:/measured").visible
        for parent, child in (*LINKS, *OF_HAND):
            scene.put_transform(parent, child, STILL, 0.0)
        scene.update(0.0)
        assert handle(scene, "/robot:/measured").visible

    def test_a_still_rig_costs_no_message(self, robot):
        before = sent(robot)
        for parent, child in (*LINKS, *OF_HAND):
            robot.put_transform(parent, child, (1e-4, 0.0, 0.0, 0.0, 0.0, 2e-4, 1.0), 1.0)
        for n in range(10):
            robot.update(0.1 * n)
        assert sent(robot) == before

    def test_one_joint_that_turns_is_one_message(self, robot):
        before = sent(robot)
        robot.put_transform(*LINKS[1], (0.0, 0.0, 0.0, 0.0, 0.0, math.sin(0.1), math.cos(0.1)), 1.0)
        robot.update(1.0)
        assert sent(robot) == before + 1

    def test_a_slow_motion_is_not_lost(self, robot):
        for n in range(200):
            robot.put_transform(*LINKS[0], (1e-5 * n, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 1.0)
            robot.update(1.0)
        x, _, _ = handle(robot, "/robot:/measured/kuka:link_0/kuka:link_1").position
        assert x == pytest.approx(2e-3, abs=6e-4)

    def test_the_ghost_is_seen_only_where_the_commanded_arm_is_elsewhere(self, robot):
        ghost = handle(robot, "/robot:/commanded")
        links = {link.name: link for link in robot._robots[""]._links.values()}
        for _, child in LINKS:
            link = links[child]
            robot.put_transform(link.parent, child, link.at(0.3), 2.0)
        for joints, visible in (([0.3] * 7, False), ([0.36] * 7, True), ([0.33] * 7, True), ([0.31] * 7, False)):
            robot.set_commanded("", joints)
            robot.update(2.0)
            assert ghost.visible is visible
        for joints in ([math.nan] * 7, None):
            robot.set_commanded("", [0.5] * 7)
            robot.update(2.0)
            assert ghost.visible
            robot.set_commanded("", joints)
            robot.update(2.0)
            assert not ghost.visible

    def test_a_bad_description_leaves_the_robot(self, robot):
        with pytest.raises(ValueError):
            robot.set_robot("", "<robot/>", read_mesh)
        assert handle(robot, "/robot:/measured") is not None


class TestDrawings:
    @pytest.fixture
    def store(self):
        return MarkerStore()

    def test_of_all_forms_come_change_and_go(self, robot, store):
        from test_cockpit_markers import Kind, marker, vector

        six = [(0.1 * n, 0.0, 0.0) for n in range(6)]
        kinds = [kind for kind in Kind if kind is not Kind.MESH]

        def take(text, x):
            more = {"text": text, "header": vector()}
            markers = [marker(kind, kind, points=[] if kind is Kind.ARROW else six, **more) for kind in kinds]
            for made in markers:
                made.header.frame_id = "kuka/link_7" if x < 1.0 else "kuka/base_frame"
                made.pose.position = vector(x, 0.0, 0.0)
            assert store.take(markers, 0.0) == []
            robot.set_drawings("topic", store.drawings(0.0))

        take("near", 0.1)
        shown = {key: node for key, (_, node, _) in robot._groups["topic"].items()}
        assert len(shown) == len(kinds) and all("kuka:link_7/drawing" in node for node in shown.values())
        before = sent(robot)
        take("near", 0.1)
        assert sent(robot) == before
        take("far", 0.2)
        assert handle(robot, shown["thing", Kind.TEXT]).text == "far"
        assert np.allclose(handle(robot, shown["thing", Kind.CUBE]).position, (0.2, 0.0, 0.0))
        take("far", 2.0)
        assert all(handle(robot, node) is None for node in shown.values())
        robot.set_drawings("topic", {})
        assert not robot._groups["topic"]

    def test_of_an_unknown_frame_are_not_shown(self, robot, store):
        from test_cockpit_markers import marker

        store.take([marker()], 0.0)
        robot.set_drawings("topic", store.drawings(0.0))
        assert not robot._groups["topic"]
        robot.put_transform("kuka/base_frame", "base", STILL, 0.0)
        robot.set_drawings("topic", store.drawings(0.0))
        assert robot._groups["topic"]


def test_a_cloud_replaces_the_one_before(robot):
    robot.put_transform("kuka/base_frame", "camera", STILL, 0.0)
    for n in (3, 5):
        robot.set_cloud("camera", np.zeros((n, 3), dtype=np.float32), np.zeros((n, 3), dtype=np.uint8))
    assert len(handle(robot, "/frames/camera/cloud").points) == 5


def test_a_label_is_hidden_until_a_page_gives_it_its_place(robot):
    robot.show_axes("kuka/link_7", 0.1, "last link")
    robot.update(1.0)
    assert not handle(robot, f"{robot._frame_node('kuka/link_7')}/axes/name").visible


def test_transforms_of_no_numbers_are_left_out(robot):
    before = sent(robot)
    for bad in ((math.nan, *STILL[1:]), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (math.inf, *STILL[1:])):
        robot.put_transform(*LINKS[0], bad, 1.0)
    robot.update(1.0)
    assert sent(robot) == before
