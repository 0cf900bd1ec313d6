"""What the parts' sources share: places on a circle, holes, pockets of nuts, countersinks. Lengths in mm."""

from __future__ import annotations

import math

import cadquery as cq

from cad import dimensions as d


def on_circle(diameter: float, angles) -> list[tuple[float, float]]:
    """Returns the places at the angles [deg] of a circle round the origin."""
    return [(diameter / 2 * math.cos(math.radians(a)), diameter / 2 * math.sin(math.radians(a))) for a in angles]


def rod(diameter: float, bottom: float, top: float, places=((0.0, 0.0),)) -> cq.Workplane:
    """Returns cylinders along z."""
    return cq.Workplane(origin=(0, 0, bottom)).pushPoints(list(places)).circle(diameter / 2).extrude(top - bottom)


def block(low, high) -> cq.Workplane:
    """Returns the box between two opposite corners."""
    size = [b - a for a, b in zip(low, high)]
    return cq.Workplane().box(*size, centered=False).translate(tuple(low))


def nut(width: float, bottom: float, top: float, place) -> cq.Workplane:
    """Returns the pocket of a nut of this width across its flats; a flat looks away from the origin."""
    corner = (width + d.NUT_PLAY) / math.cos(math.radians(30.0))
    outwards = math.degrees(math.atan2(place[1], place[0]))
    pocket = cq.Workplane(origin=(0, 0, bottom)).polygon(6, corner).extrude(top - bottom)
    return pocket.rotate((0, 0, 0), (0, 0, 1), outwards + 30.0).translate((*place, 0.0))


def nuts(width: float, bottom: float, top: float, places) -> cq.Workplane:
    """Returns the pockets of nuts at several places."""
    result = cq.Workplane()
    for place in places:
        result = result.add(nut(width, bottom, top, place))
    return result.combine()


def cone(diameter: float, top: float, place) -> cq.Workplane:
    """Returns the countersink of a 90 deg head: its edge of this diameter lies at the height `top`."""
    solid = cq.Solid.makeCone(0.0, diameter / 2, diameter / 2, pnt=cq.Vector(*place, top - diameter / 2))
    return cq.Workplane(solid)
