"""The 3-D scene of the cockpit: a server of viser, which draws in the browser what RViz draws on a screen."""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
import viser

from leap_rig.cockpit.frame_poses import IDENTITY, FramePoses, Pose7, angle_between, compose, differ
from leap_rig.cockpit.labels import Eye, Label, anchors
from leap_rig.cockpit.markers import Drawing, Form
from leap_rig.cockpit.robot_tree import DrawnLink, Surface, links_of, surfaces_of

LOOPBACK = "127.0.0.1"
STYLE = b"""<style>
.mantine-Notifications-root, .mantine-Paper-root, [title="About Viser"], [data-dock-root] > :not(:first-child)
{ display: none !important; }
</style>"""
"""Hides what is viser's own: its panel, its mark and its notes."""
WORKER = b"""<script>
{
  const Plain = Worker;
  window.Worker = function (address, options) {
    const request = new XMLHttpRequest();
    request.open("GET", address, false);
    request.send();
    const made = new Plain("data:text/javascript;charset=utf-8," + encodeURIComponent(request.responseText), options);
    const post = made.postMessage.bind(made);
    made.postMessage = (data, ...more) => {
      const canvas = document.querySelector("canvas"), said = data.message;
      if (said && said.type === "ViewerCameraMessage" && canvas) {
        data = {...data, message: {...said, image_width: canvas.clientWidth, image_height: canvas.clientHeight}};
      }
      post(data, ...more);
    };
    let again;
    made.addEventListener("message", ({data: {type}}) => {
      if (type !== "closed" && type !== "connected") return;
      parent.postMessage(type, "*");
      clearTimeout(again);
      if (type === "closed") again = setTimeout(() => { if (!document.hasFocus()) post({type: "retry"}); }, 1000);
    });
    return made;
  };
}
</script>"""
"""viser's thread for its WebSocket begins from a blob, which a sandboxed frame refuses; the same text it takes. The
size of the view that it sends becomes that on the page, in which labels have one size on every screen. The outer
page is told when the connection ends and when it is back. viser reconnects only in a frame that has focus; this makes
it reconnect in any."""
DRAW_LESS = b"""<script>
"use strict";
{
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  if (/swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer)) {
    const DRAW_MS = 160, draw = requestAnimationFrame.bind(window), waiting = new Map();
    let number = 0, asked = false, last = -Infinity;
    const run = now => {
      asked = false;
      last = now;
      const due = [...waiting.values()];
      waiting.clear();
      for (const call of due) try { call(now); } catch (fault) { reportError(fault); }
    };
    window.requestAnimationFrame = call => {
      waiting.set(++number, call);
      if (!asked) {
        asked = true;
        setTimeout(() => draw(run), Math.max(0, last + DRAW_MS - performance.now()));
      }
      return number;
    };
    window.cancelAnimationFrame = number => { waiting.delete(number); };
    history.replaceState(null, "", "?fixedDpr=1");  // a parameter of viser: pixels that are drawn for one of the page
    const context = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, options) {
      return context.call(this, kind, {...options, antialias: false});
    };
  }
}
</script></head>"""
"""Where no graphics card draws, but a processor, which may be the rig's: plain edges, at most six times a second."""
TELL_DRAWN = b"""<script>
"use strict";
{
  const LEAST = 1000, kind = WebGL2RenderingContext.prototype, told = new Set();
  const tell = text => { if (!told.has(text)) parent.postMessage(text, "*"); told.add(text); };
  if (!document.createElement("canvas").getContext("webgl2")) tell("no WebGL");
  for (const name of ["drawElements", "drawElementsInstanced"]) {
    const draw = kind[name];
    kind[name] = function (mode, count, ...more) {
      draw.call(this, mode, count, ...more);
      tell("begun");
      if (count < LEAST || this.getParameter(this.FRAMEBUFFER_BINDING)) return;
      kind[name] = draw;
      const drawn = this.fenceSync(this.SYNC_GPU_COMMANDS_COMPLETE, 0);
      const wait = setInterval(() => {
        if (this.getSyncParameter(drawn, this.SYNC_STATUS) !== this.SIGNALED) return;
        clearInterval(wait);
        tell("drawn");
      }, 50);
    };
  }
}
</script>"""
"""Tells the page around it when the scene is drawn, and when a robot is in it: nothing else has so many corners."""
BACKGROUND = (92, 99, 109)
NO_SHADOW: Mapping[str, Any] = {
    "cast_shadow": False,
    "receive_shadow": False,
}  # of software that draws, it would take most of the time
MEASURED: Mapping[str, Any] = {}
GHOST: Mapping[str, Any] = {"color": (90, 170, 255), "opacity": 0.3}  # of the commanded arm
LABELS_PERIOD_S = 0.3
AXES_LAST_S = 3.0  # axes of a frame that comes no more are hidden


class StartView(NamedTuple):
    """What a page looks at first: a ball, from a side and from above."""

    middle: tuple[float, float, float]  # [m]
    radius: float  # [m]
    yaw: float  # of the eye about the middle [rad]
    pitch: float


ONE_ARM = StartView((0.22, -0.02, 0.36), 0.62, -0.5, 0.38)
TWO_ARMS = StartView((0.25, 0.0, 0.3), 0.9, math.pi, 0.65)
FOV = math.radians(45.0)  # upright


class SceneServer:
    """The scene and its server, on a free port of this machine alone: who lets a page from elsewhere see it passes
    `page` and the WebSocket on. Nothing that a page sends there has an effect but on its own view. One thread calls
    what shows something."""

    def __init__(self, arms: int = 1) -> None:
        self.inset = False  # whether the page shows a camera's image over the lower right corner
        self._view = ONE_ARM if arms < 2 else TWO_ARMS
        with contextlib.redirect_stdout(io.StringIO()):  # it prints its address, which is of no use to anybody
            self._server = viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
        self._server._websock_server._incoming_handlers.clear()
        self._server._websock_server.on_client_connect(_deafen)
        self._poses = FramePoses()
        self._root = ""
        self._robots: dict[str, _Robot] = {}
        self._frames: dict[str, _Placed] = {}
        self._axes: dict[str, _Placed] = {}
        self._groups: dict[str, dict[Hashable, tuple[Drawing, str, Any]]] = {}
        self._labels = _Labels()
        self._numbers = itertools.count()
        self._next_labels = 0.0
        self._cloud: tuple[str, Any] | None = None
        scene = self._server.scene
        scene.set_background_image(np.full((4, 4, 3), BACKGROUND, dtype=np.uint8), format="png")
        scene.configure_default_lights(cast_shadow=False)
        # Without its reflections, which take half of the time where a processor draws.
        scene.configure_environment_map(hdri=None)
        scene.add_light_ambient("/light", intensity=1.5)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        self._server.on_client_connect(self._look)

    @property
    def port(self) -> int:
        return self._server.get_port()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the WebSocket, whose path is /."""
        return LOOPBACK, self.port

    @property
    def page(self) -> bytes:
        """The page, HTML in one piece: it needs no other file, and shows the scene alone."""
        html = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_bytes()
        return html.replace(b"</head>", STYLE + WORKER + TELL_DRAWN + DRAW_LESS, 1)

    @property
    def viewers(self) -> int:
        """How many pages show the scene."""
        return len(self._server.get_clients())

    def close(self) -> None:
        self._server.stop()

    def _look(self, client: viser.ClientHandle) -> None:
        """Lets a page that has just come look at the whole rig, whatever the shape of its window."""
        if not np.isfinite(client.camera.position).all():
            return  # not a page of viser's
        view, half, eye = self._view, 0.5 * FOV, _eye_of(client.camera)
        aspect = eye.width / eye.height if eye is not None else 1.0
        narrow = min(half, math.atan(math.tan(half) * max(aspect, 0.2)))
        away = view.radius / math.sin(narrow)
        level = math.cos(view.pitch) * away
        offset = level * math.cos(view.yaw), level * math.sin(view.yaw), math.sin(view.pitch) * away
        client.camera.fov = FOV
        client.camera.position = np.add(view.middle, offset)
        client.camera.look_at = np.array(view.middle)

    def set_robot(self, arm: str, urdf: str, read_mesh: Callable[[str], str]) -> None:
        """Shows the robot of a description, whose frames have the prefix `arm`, empty for an only arm. `read_mesh`
        returns the text of a mesh by its address. Raises DescriptionFault or OSError; what was shown then stays."""
        links = links_of(urdf)
        surfaces = {link.name: surfaces_of(link, read_mesh) for link in links}
        old = self._robots.pop(arm, None)
        if old is not None:
            old.remove()
            for shown in self._groups.values():
                for key in [key for key, (_, node, _) in shown.items() if node.startswith(old.top)]:
                    del shown[key]
        self._robots[arm] = _Robot(self._server.scene, arm, links, surfaces)

    def show_axes(self, frame: str, length_m: float, name: str = "") -> None:
        """Shows the axes of a frame while it comes, with a name unless that is empty."""
        if frame not in self._axes:
            node, scene = f"{self._frame_node(frame)}/axes", self._server.scene
            axes = scene.add_frame(node, axes_length=length_m, axes_radius=0.05 * length_m, origin_radius=0.0)
            self._axes[frame] = _Placed(axes)
            if name:
                self._labels.put(frame, frame, (0.0, 0.0, 0.0), name, scene.add_label(f"{node}/name", name))

    def put_transform(self, parent: str, child: str, numbers: Pose7, now: float) -> None:
        """Takes a transform of tf that was received at `now` [s, monotonic; infinite for a static one]; one that is not
        finite, or not of a rotation, is left out."""
        norm = math.hypot(*numbers[3:])
        if math.isfinite(sum(numbers)) and 0.9 < norm < 1.1:
            self._poses.put(parent, child, numbers, now)

    def set_commanded(self, arm: str, joints: Sequence[float] | None) -> None:
        """Takes the joints [rad] that an arm is commanded to, in the order of the description, or None: unknown."""
        if arm in self._robots:
            self._robots[arm].commanded = joints

    def set_drawings(self, group: str, drawings: Mapping[Hashable, Drawing]) -> None:
        """Shows these drawings in place of those that the group had; none whose frame tf does not know."""
        shown = self._groups.setdefault(group, {})
        for key in [key for key in shown if key not in drawings]:
            shown.pop(key)[2].remove()
            self._labels.drop((group, key))
        for key, drawing in drawings.items():
            old, node, handle = shown.get(key, (None, "", None))
            if old is drawing or (old is None and self._in_root(drawing.frame) is None):
                continue
            parent = self._frame_node(drawing.frame)
            if old is None or not node.startswith(parent + "/drawing"):
                if handle is not None:
                    handle.remove()
                old = None
                node = f"{parent}/drawing{next(self._numbers)}"
            if old is None or not _updated(handle, old, drawing):
                handle = _drawn(self._server.scene, node, drawing)
            shown[key] = drawing, node, handle
            if drawing.form is Form.TEXT:
                self._labels.put((group, key), drawing.frame, drawing.position, drawing.text, handle)

    def set_cloud(self, frame: str, points: np.ndarray, colours: np.ndarray) -> None:
        """Shows a point cloud: points in the frame, shape (n, 3) [m], and their colours, shape (n, 3), bytes."""
        least_m, most_m = 0.002, 0.02
        apart = np.linalg.norm(np.diff(points, axis=0), axis=1)  # mostly of neighbours in a row of the camera's image
        covering = 0.65  # squares of twice this size touch, also where the camera looks at a surface from the side
        size = min(max(covering * float(np.median(apart)), least_m), most_m) if len(apart) else least_m
        node = f"{self._frame_node(frame)}/cloud"
        if self._cloud is not None and self._cloud[0] != node:
            self._cloud[1].remove()
        cloud = self._server.scene.add_point_cloud(
            node, points, colours, point_size=round(size, 3), point_shape="square", point_shading="flat"
        )
        self._cloud = node, cloud

    def update(self, now: float) -> None:
        """Moves what has moved visibly; `now` as in `put_transform`."""
        bases = [found for robot in self._robots.values() if (found := self._poses.chain(robot.base))]
        self._root = bases[0][0] if bases else self._root
        for robot in self._robots.values():
            robot.update(self._in_root(robot.base), self._poses)
        for frame, placed in self._frames.items():
            placed.move_or_hide(self._in_root(frame))
        for frame, axes in self._axes.items():
            axes.show(now - self._poses.received(frame) < AXES_LAST_S)
        if now >= self._next_labels:
            self._next_labels = now + LABELS_PERIOD_S
            self._labels.arrange(self._eye(), self._in_root, self.inset)

    def together(self) -> contextlib.AbstractContextManager[None]:
        """A context whose changes reach a page in one piece."""
        return self._server.atomic()

    def _eye(self) -> Eye | None:
        """Returns how the page looks whose view was moved last."""
        cameras = [client.camera for client in self._server.get_clients().values()]
        return _eye_of(max(cameras, key=lambda camera: camera.update_timestamp)) if cameras else None

    def _in_root(self, frame: str) -> Pose7 | None:
        found = self._poses.chain(frame)
        return found[1] if found is not None and found[0] == self._root else None

    def _frame_node(self, frame: str) -> str:
        """Returns the name of the node that stands for a frame."""
        for robot in self._robots.values():
            if frame in robot.nodes:
                return robot.nodes[frame]
        name = f"/frames/{_plain(frame)}"
        if frame not in self._frames:
            self._frames[frame] = _Placed.frame(self._server.scene, name)
        return name


def _deafen(connection: Any) -> None:
    """Of what a page may send, its camera alone is taken: viser would else build a tunnel to a server on the internet
    for whoever asks, or keep files."""
    handlers = connection._incoming_handlers
    for kind in [kind for kind in handlers if kind.__name__ != "ViewerCameraMessage"]:
        del handlers[kind]


def _eye_of(camera: viser.CameraHandle) -> Eye | None:
    """Returns a page's camera, or None if the page sent values that are not finite numbers."""
    try:
        size = float(camera.image_width), float(camera.image_height)
        (x, y, z), (w, i, j, k), fov = camera.position.astype(float), camera.wxyz.astype(float), float(camera.fov)
    except (TypeError, ValueError):
        return None
    if not (math.isfinite(x + y + z) and abs(math.hypot(w, i, j, k) - 1.0) < 0.1):
        return None
    if not (0.01 < fov < 3.0 and all(1.0 <= length <= 1e5 for length in size)):
        return None
    return Eye((x, y, z), (i, j, k, w), fov, *size)


class _Placed:
    """A node that is sent only what an eye sees of its motion."""

    def __init__(self, handle: Any, visible: bool = True) -> None:
        self.handle = handle
        self._pose: Pose7 = IDENTITY
        self._visible = visible

    @classmethod
    def frame(cls, scene: viser.SceneApi, name: str) -> _Placed:
        return cls(scene.add_frame(name, show_axes=False, visible=False), visible=False)

    def move_or_hide(self, pose: Pose7 | None) -> None:
        self.show(pose is not None)
        if pose is not None:
            self.move(pose)

    def move(self, pose: Pose7) -> None:
        moved, turned = differ(pose[:3], self._pose[:3]), differ(pose[3:], self._pose[3:])
        if moved:
            self.handle.position = pose[:3]
        if turned:
            x, y, z, w = pose[3:]
            self.handle.wxyz = (w, x, y, z)
        self._pose = (*(pose if moved else self._pose)[:3], *(pose if turned else self._pose)[3:])

    def show(self, visible: bool) -> None:
        if visible != self._visible:
            self._visible = self.handle.visible = visible


class _Robot:
    """The links of a robot, each below the one that it hangs on, and once more as a ghost at the commanded joints."""

    def __init__(
        self,
        scene: viser.SceneApi,
        arm: str,
        links: Sequence[DrawnLink],
        surfaces: Mapping[str, Sequence[Surface]],
    ) -> None:
        self.commanded: Sequence[float] | None = None
        self._frames = {link.name: f"{arm}/{link.name}" if arm else link.name for link in links}
        self.base = self._frames[links[0].name]
        self.top = f"/robot:{_plain(arm)}/"
        self._top, self._ghost = (_Placed.frame(scene, self.top + part) for part in ("measured", "commanded"))
        self._links = {link.name: link for link in links[1:]}
        self._measured, nodes = self._chain(scene, f"{self.top}measured", links, surfaces)
        of_ghost = {link.name: surfaces[link.name] for link in links[1:]}
        self._commanded, _ = self._chain(scene, f"{self.top}commanded", links, of_ghost, GHOST)
        self.nodes = {self._frames[name]: node for name, node in nodes.items()}
        self._differs = False

    @staticmethod
    def _chain(
        scene: viser.SceneApi,
        top: str,
        links: Sequence[DrawnLink],
        surfaces: Mapping[str, Sequence[Surface]],
        look: Mapping[str, Any] = MEASURED,
    ) -> tuple[dict[str, _Placed], dict[str, str]]:
        placed, nodes = {}, {links[0].name: top}
        for link in links:
            if link is not links[0]:
                nodes[link.name] = f"{nodes[link.parent]}/{_plain(link.name)}"
                placed[link.name] = _Placed(scene.add_frame(nodes[link.name], show_axes=False))
                placed[link.name].move(link.at(0.0))
            for number, surface in enumerate(surfaces.get(link.name, ())):
                scene.add_mesh_simple(
                    f"{nodes[link.name]}/surface{number}", surface.vertices, surface.triangles,
                    **{"color": surface.colour, "flat_shading": not surface.smooth, **NO_SHADOW, **look},
                )  # fmt: skip
        return placed, nodes

    def remove(self) -> None:
        self._top.handle.remove()
        self._ghost.handle.remove()

    def update(self, T_root_base: Pose7 | None, poses: FramePoses) -> None:
        """Moves the links to where tf has them; hides the robot while a moving one is unknown."""
        measured = {}
        for name, link in self._links.items():
            found = poses.relative(self._frames[link.parent], self._frames[name])
            if found is None and link.moves:
                T_root_base = None
                break
            measured[name] = link.at(0.0) if found is None else found
        self._top.move_or_hide(T_root_base)
        if T_root_base is not None:
            for name, pose in measured.items():
                self._measured[name].move(pose)
        self._update_ghost(T_root_base, measured)

    def _update_ghost(self, T_root_base: Pose7 | None, measured: Mapping[str, Pose7]) -> None:
        appears, vanishes = 0.04, 0.02  # difference of a joint [rad]; 0.02 rad are 2 cm at the end of the arm
        joints = self.commanded
        if T_root_base is None or joints is None or not all(map(math.isfinite, joints)):
            self._ghost.show(False)
            return
        moving = [link for link in self._links.values() if link.moves]
        commanded = {**measured, **{link.name: link.at(angle) for link, angle in zip(moving, joints)}}
        apart = max((angle_between(commanded[name], measured[name]) for name in measured), default=0.0)
        self._differs = apart > (vanishes if self._differs else appears)
        self._ghost.move_or_hide(T_root_base if self._differs else None)
        if self._differs:
            for name, pose in commanded.items():
                self._commanded[name].move(pose)


class _Labels:
    """The labels of the scene, arranged for the page that moved last: none covers another."""

    def __init__(self) -> None:
        self._labels: dict[Hashable, tuple[str, tuple[float, float, float], str, Any]] = {}
        self._seen: tuple = ()

    def put(self, key: Hashable, frame: str, point: tuple[float, float, float], text: str, handle: Any) -> None:
        handle.visible = False  # until it has its place
        self._labels[key], self._seen = (frame, point, text, handle), ()

    def drop(self, key: Hashable) -> None:
        self._labels.pop(key, None)

    def arrange(self, eye: Eye | None, in_root: Callable[[str], Pose7 | None], inset: bool) -> None:
        """Gives each label its place, if they or the eye have moved."""
        if eye is None:
            return
        labels = []
        for key, (frame, point, text, _) in self._labels.items():
            T_root_frame = in_root(frame)
            if T_root_frame is not None:
                x, y, z, *_ = compose(T_root_frame, (*point, *IDENTITY[3:]))
                labels.append(Label(key, text, (x, y, z)))
        coarse_m = 0.01
        seen = eye, inset, [(key, text, *(round(x / coarse_m) for x in point)) for key, text, point in labels]
        if seen == self._seen:
            return
        self._seen = seen
        # What markers say comes before the names of axes, whose keys are texts.
        found = anchors(sorted(labels, key=lambda label: isinstance(label.key, str)), eye, inset)
        for key, (_, _, _, handle) in self._labels.items():
            handle.visible = key in found
            if key in found:
                handle.anchor = found[key]


def _drawn(scene: viser.SceneApi, node: str, drawing: Drawing) -> Any:
    """Draws anew, in place of what was drawn at this node."""
    x, y, z, w = drawing.orientation
    at: dict[str, Any] = {"position": drawing.position, "wxyz": (w, x, y, z)}
    points, colours, size = drawing.points, drawing.colours, drawing.size
    if drawing.form is Form.LINES:
        return scene.add_line_segments(node, points, colours, thickness=max(size[0], 0.003), **at)
    if drawing.form is Form.ARROWS:
        shaft, head, length = 0.5 * size[0], 0.5 * size[1], size[2]
        return scene.add_arrows(node, points, colours, shaft_radius=shaft, head_radius=head, head_length=length, **at)
    if drawing.form is Form.POINTS:
        return scene.add_point_cloud(node, points, colours, point_size=size[0], point_shading="flat", **at)
    if drawing.form is Form.TEXT:
        return scene.add_label(node, drawing.text, anchor="bottom-center", **at)
    opacity = drawing.opacity if drawing.opacity < 1.0 else None
    if drawing.form is Form.TRIANGLES:
        colour = tuple(np.mean(colours.reshape(-1, 3), axis=0).astype(int).tolist())
        faces = np.arange(3 * len(points)).reshape(-1, 3)
        look: dict[str, Any] = {"color": colour, "opacity": opacity, "side": "double", **NO_SHADOW}
        return scene.add_mesh_simple(node, points.reshape(-1, 3), faces, **look, **at)
    if drawing.form is Form.BOXES:
        body = trimesh.creation.box((1.0, 1.0, 1.0))
    elif drawing.form is Form.BALLS:
        body = trimesh.creation.icosphere(subdivisions=2 if len(points) == 1 else 1, radius=0.5)
    else:
        body = trimesh.creation.cylinder(radius=0.5, height=1.0, sections=24)
    return scene.add_batched_meshes_simple(
        node, body.vertices, body.faces, np.tile((1.0, 0.0, 0.0, 0.0), (len(points), 1)), points,
        batched_scales=np.tile(size, (len(points), 1)), batched_colors=colours, opacity=opacity, lod="off",
        flat_shading=drawing.form is not Form.BALLS, **NO_SHADOW, **at,
    )  # fmt: skip


def _updated(handle: Any, old: Drawing, new: Drawing) -> bool:
    """Changes what is drawn; returns False where it has to be drawn anew."""
    same = old.form is new.form and (old.size, old.opacity) == (new.size, new.opacity)
    same &= old.points.shape == new.points.shape and old.colours.shape == new.colours.shape
    if not same or (new.form is Form.TRIANGLES and not np.array_equal(old.points, new.points)):
        return False
    if new.position != old.position:
        handle.position = new.position
    if new.orientation != old.orientation:
        x, y, z, w = new.orientation
        handle.wxyz = (w, x, y, z)
    if new.form is Form.TEXT:
        handle.text = new.text
    elif new.form in (Form.BOXES, Form.BALLS, Form.CYLINDERS):
        handle.batched_positions, handle.batched_colors = new.points, new.colours
    elif new.form is not Form.TRIANGLES:
        handle.points, handle.colors = new.points, new.colours
    return True


def _plain(name: str) -> str:
    """Returns a name of a node: a slash would make another level of it."""
    return re.sub(r"[^\w.-]", ":", name)[:100]
