"""Workshop drawings as SVG: views and sections of a solid with its dimensions, on an A4 sheet in true millimetres.

A view is seen along an axis: u to the right and v up on the sheet, in the part's millimetres. Offsets of dimension
lines and texts are in millimetres of the sheet.
"""

from __future__ import annotations

import math
from xml.sax.saxutils import escape

import cadquery as cq
from OCP.BRepLib import BRepLib
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape

WIDTH, HEIGHT, MARGIN = 297.0, 210.0, 8.0
SAGITTA = 0.05
ARROW, TEXT, LINE = 2.2, 3.2, 4.2
HUGE = 1000.0

# From where it is seen: direction towards the viewer, and the part's direction that points right on the sheet.
DIRECTIONS = {
    "z": ((0, 0, 1), (1, 0, 0)),
    "-z": ((0, 0, -1), (-1, 0, 0)),
    "y": ((0, 1, 0), (-1, 0, 0)),
    "-y": ((0, -1, 0), (1, 0, 0)),
    "x": ((1, 0, 0), (0, 1, 0)),
    "-x": ((-1, 0, 0), (0, -1, 0)),
    "edge": ((-1, 0, 0), (0, 0, 1)),
}

STYLE = """
text { font: 3.2px 'DejaVu Sans', Arial, sans-serif; fill: #000 }
.title { font-size: 4.6px; font-weight: bold }
path { fill: none; stroke: #000; stroke-linecap: round; stroke-linejoin: round }
.edge { stroke-width: 0.5 } .thin { stroke-width: 0.18 } .frame { stroke-width: 0.7 }
.centre { stroke-width: 0.18; stroke-dasharray: 6 1.2 0.8 1.2 }
.arrow { fill: #000; stroke: none }
.hatch { fill: url(#hatch); stroke: none; fill-rule: evenodd }
"""


class Sheet:
    """A sheet with views.

    Args:
        name, title: of the part.
        scale: 0.5 draws half as large.
        note: what stands in the title block besides.
    """

    def __init__(self, name: str, title: str, scale: float, note: str) -> None:
        self._name, self._title, self.scale, self._note = name, title, scale, note
        self._items: list[str] = []

    def view(self, part: cq.Workplane, direction: str, at: tuple[float, float], label: str, below: float = 8.0) -> View:
        """Draws what is seen from a direction, the part's origin at a place of the sheet, its name so far below."""
        view = View(self, at, direction)
        view.edges(part.val())
        view.label(part, label, below)
        return view

    def section(self, part: cq.Workplane, across: str, at: tuple[float, float], label: str, below: float = 8.0) -> View:
        """Draws a section through the origin: "x" or "y" is the normal of its plane, "diagonal" cuts at 45 deg."""
        if across == "diagonal":
            part, across = part.rotate((0, 0, 0), (0, 0, 1), -45.0), "y"
        x = across == "x"
        removed = cq.Workplane().box(HUGE, HUGE, HUGE).translate((HUGE / 2, 0, 0) if x else (0, -HUGE / 2, 0))
        half = part.cut(removed)
        view = View(self, at, "x" if x else "-y")
        faces = [f for f in half.faces("|X" if x else "|Y").vals() if abs(f.Center().x if x else f.Center().y) < 1e-6]
        for face in faces:
            view.hatch(face)
        for solid in half.vals():
            view.edges(solid)
        view.label(part, label, below)
        return view

    def path(self, kind: str, points, closed: bool = False) -> None:
        """Draws a line through points of the sheet."""
        self._items.append(f'<path class="{kind}" d="{_path(points)}{"Z" if closed else ""}"/>')

    def raw(self, item: str) -> None:
        """Draws an SVG element."""
        self._items.append(item)

    def text(self, x: float, y: float, text: str, anchor: str = "middle", kind: str = "", turn: float = 0.0) -> None:
        """Writes at a place of the sheet."""
        turned = f' transform="rotate({turn:g} {x:.2f} {y:.2f})"' if turn else ""
        kind = f' class="{kind}"' if kind else ""
        self._items.append(f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}"{kind}{turned}>{escape(text)}</text>')

    def arrow(self, tip, towards) -> None:
        """Draws an arrow's head whose tip points away from `towards`."""
        dx, dy = towards[0] - tip[0], towards[1] - tip[1]
        length = math.hypot(dx, dy) or 1.0
        dx, dy = ARROW * dx / length, ARROW * dy / length
        sides = [(tip[0] + dx + s * dy * 0.17, tip[1] + dy - s * dx * 0.17) for s in (-1, 1)]
        self.path("arrow", [tip, *sides], closed=True)

    def svg(self) -> str:
        """Returns the sheet."""
        right, bottom = WIDTH - MARGIN, HEIGHT - MARGIN
        frame = [(MARGIN, MARGIN), (right, MARGIN), (right, bottom), (MARGIN, bottom)]
        self.path("frame", frame, closed=True)
        top, left = bottom - 15.0, right - 150.0
        self.path("frame", [(left, bottom), (left, top), (right, top)])
        self.path("thin", [(left, top + 8), (right, top + 8)])
        self.text(left + 3, top + 5.8, self._title, "start", "title")
        self.text(right - 3, top + 5.8, self._name, "end")
        scale = f"1:{1 / self.scale:g}" if self.scale < 1.0 else f"{self.scale:g}:1"
        self.text(left + 3, top + 12.8, f"scale {scale} · mm · {self._note}", "start")
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH:g}mm" height="{HEIGHT:g}mm" '
            f'viewBox="0 0 {WIDTH:g} {HEIGHT:g}"><style>{STYLE}</style><defs><pattern id="hatch" width="2" height="2" '
            f'patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><path d="M0,0V2" stroke-width="0.25"/>'
            f'</pattern></defs><rect width="100%" height="100%" fill="#fff"/>\n' + "\n".join(self._items) + "\n</svg>\n"
        )


class View:
    """One view on a sheet."""

    def __init__(self, sheet: Sheet, at: tuple[float, float], direction: str) -> None:
        self._sheet, self._at = sheet, at
        self._towards, self._right = DIRECTIONS[direction]
        n, u = self._towards, self._right
        self._up = tuple(n[(i + 1) % 3] * u[(i + 2) % 3] - n[(i + 2) % 3] * u[(i + 1) % 3] for i in range(3))

    def point(self, u: float, v: float) -> tuple[float, float]:
        """Returns the place on the sheet."""
        return self._at[0] + u * self._sheet.scale, self._at[1] - v * self._sheet.scale

    def seen(self, place: tuple[float, float]) -> tuple[float, float]:
        """Returns u, v of a point in the part's plane z = 0."""
        return tuple(place[0] * axis[0] + place[1] * axis[1] for axis in (self._right, self._up))

    def edges(self, shape: cq.Shape) -> None:
        """Draws the visible edges."""
        algorithm = HLRBRep_Algo()
        algorithm.Add(shape.wrapped)
        axes = gp_Ax2(gp_Pnt(), gp_Dir(*self._towards), gp_Dir(*self._right))
        algorithm.Projector(HLRAlgo_Projector(axes))
        algorithm.Update()
        algorithm.Hide()
        found = HLRBRep_HLRToShape(algorithm)
        lines = set()
        for compound in (found.VCompound(), found.OutLineVCompound()):
            if compound is None or compound.IsNull():
                continue
            BRepLib.BuildCurves3d_s(compound)
            for edge in cq.Shape.cast(compound).Edges():
                lines.add(_path(self.point(p.x, p.y) for p in _along(edge)))
        self._sheet.raw(f'<path class="edge" d="{" ".join(sorted(lines))}"/>')

    def hatch(self, face: cq.Face) -> None:
        """Hatches a face that looks at the viewer."""
        loops = []
        for wire in [face.outerWire(), *face.innerWires()]:
            points = [p for edge in _in_order(wire) for p in edge]
            loops.append(_path(self.point(_dot(p, self._right), _dot(p, self._up)) for p in points) + "Z")
        self._sheet.raw(f'<path class="hatch" d="{" ".join(loops)}"/>')

    def label(self, part: cq.Workplane, text: str, below: float) -> None:
        """Writes the view's name below it."""
        box = part.val().BoundingBox()
        x, y = self.point(0, box.ymin if self._up[1] else box.zmin)
        self._sheet.text(x, y + below, text)

    def horizontal(self, u0, u1, v, offset, text: str = "", from_v: float | None = None) -> None:
        """Dimensions a width between u0 and u1, the line `offset` above the height v."""
        start = v if from_v is None else from_v
        (x0, y), (x1, _) = self.point(u0, v), self.point(u1, v)
        line = y - offset
        for x, u in ((x0, u0), (x1, u1)):
            self._sheet.path("thin", [self.point(u, start), (x, line - math.copysign(1.0, offset))])
        self._measure((x0, line), (x1, line), text or f"{u1 - u0:g}", 0.0)

    def vertical(self, u, v0, v1, offset, text: str = "", from_u: float | None = None) -> None:
        """Dimensions a height between v0 and v1, the line `offset` to the right of u."""
        start = u if from_u is None else from_u
        (x, y0), (_, y1) = self.point(u, v0), self.point(u, v1)
        line = x + offset
        for y, v in ((y0, v0), (y1, v1)):
            self._sheet.path("thin", [self.point(start, v), (line + math.copysign(1.0, offset), y)])
        self._measure((line, y0), (line, y1), text or f"{v1 - v0:g}", -90.0)

    def diameter(self, centre, diameter: float, angle: float, text: str) -> None:
        """Dimensions a circle through its centre at an angle [deg], the text outside."""
        c, s, r = math.cos(math.radians(angle)), math.sin(math.radians(angle)), diameter / 2
        ends = [self.point(centre[0] + k * r * c, centre[1] + k * r * s) for k in (-1, 1)]
        far = (ends[1][0] + 8 * c, ends[1][1] - 8 * s)
        self._sheet.path("thin", [ends[0], far])
        self._sheet.arrow(ends[0], ends[1])
        self._sheet.arrow(ends[1], ends[0])
        self._sheet.text(far[0] + 1.0, far[1] + 2.0, text, "start")

    def leader(self, place, shift, lines: list[str]) -> None:
        """Writes lines of text at the end of an arrow that points at a place."""
        tip = self.point(*place)
        end = (tip[0] + shift[0], tip[1] - shift[1])
        self._sheet.path("thin", [tip, end])
        self._sheet.arrow(tip, end)
        side = 1.0 if shift[0] >= 0 else -1.0
        first = end[1] - LINE * (len(lines) - 1) if shift[1] > 0 else end[1] + 2.0
        for i, line in enumerate(lines):
            self._sheet.text(end[0] + side, first + LINE * i, line, "start" if side > 0 else "end")

    def circle(self, centre, diameter: float) -> None:
        """Draws the circle on which holes lie, and its centre."""
        turn = [2 * math.pi * i / 72 for i in range(72)]
        points = [(centre[0] + diameter / 2 * math.cos(a), centre[1] + diameter / 2 * math.sin(a)) for a in turn]
        self._sheet.path("centre", [self.point(*p) for p in points], closed=True)
        self.cross(centre)

    def cross(self, centre, reach: float = 6.0) -> None:
        """Marks a centre."""
        x, y = self.point(*centre)
        self._sheet.path("centre", [(x - reach, y), (x + reach, y)])
        self._sheet.path("centre", [(x, y - reach), (x, y + reach)])

    def _measure(self, start, end, text: str, turn: float) -> None:
        length = math.hypot(end[0] - start[0], end[1] - start[1])
        inside = length > 3 * ARROW
        ux, uy = (end[0] - start[0]) / length, (end[1] - start[1]) / length
        reach = 0.0 if inside else 2.2 * ARROW
        outer = (start[0] - reach * ux, start[1] - reach * uy), (end[0] + reach * ux, end[1] + reach * uy)
        self._sheet.path("thin", outer)
        self._sheet.arrow(start, end if inside else outer[0])
        self._sheet.arrow(end, start if inside else outer[1])
        x, y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
        if length < 0.62 * TEXT * len(text) + 1.0:
            room = reach + 0.35 * TEXT * len(text) + 0.5
            x, y = end[0] + room * ux, end[1] + room * uy
        self._sheet.text(x - (0.9 if turn else 0.0), y - (0.0 if turn else 0.9), text, turn=turn)


def _dot(p: cq.Vector, axis) -> float:
    return p.x * axis[0] + p.y * axis[1] + p.z * axis[2]


def _along(edge: cq.Edge) -> list[cq.Vector]:
    """Returns points along an edge, as many as its bend needs."""
    if edge.geomType() == "LINE":
        return [edge.startPoint(), edge.endPoint()]
    count = max(4, math.ceil(edge.Length() / math.sqrt(8 * SAGITTA * max(edge.Length() / 6.3, 0.5))))
    return edge.positions([i / count for i in range(count + 1)])


def _in_order(wire: cq.Wire) -> list[list[cq.Vector]]:
    """Returns the points of a wire's edges, each from the end of the one before."""
    left = [_along(edge) for edge in wire.Edges()]
    chain = [left.pop(0)]
    while left:
        end = chain[-1][-1]
        best = min(range(len(left)), key=lambda i: min((left[i][0] - end).Length, (left[i][-1] - end).Length))
        points = left.pop(best)
        chain.append(points if (points[0] - end).Length <= (points[-1] - end).Length else points[::-1])
    first, second = chain[0], chain[1] if len(chain) > 1 else chain[0]
    if len(chain) > 1 and (first[0] - second[0]).Length < (first[-1] - second[0]).Length:
        chain[0] = first[::-1]
    return chain


def _path(points) -> str:
    return "M" + "L".join(f"{x:.2f},{y:.2f}" for x, y in points)
