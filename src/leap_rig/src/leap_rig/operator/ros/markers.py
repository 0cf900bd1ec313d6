"""The pressure on the robot's fingers and the rows of the operator's view as markers for RViz."""

from __future__ import annotations

from collections.abc import Sequence

import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE, ONE_ARM, ArmFrames
from common.hand_tracking import RIGHT
from common.operator_rows import BRIGHT_COLOURS, Row, RowTone, plain_text
from leap_motion.ros.hand_markers import marker
from leap_motion.skeleton import traffic_light
from rig_description.hand import EXTENT, TAXEL_NORMALS, TAXEL_POSITIONS

LIFETIME = rospy.Duration.from_sec(1.0)  # a marker that is not renewed vanishes; the rows come every 0.5 s
WORST = (RowTone.FAULT, RowTone.WARNING, RowTone.GOOD, RowTone.NORMAL, RowTone.STALE)


def view_markers(rows: Sequence[Row], pressures: Sequence[Sequence[float]], frames: ArmFrames = ONE_ARM) -> MarkerArray:
    """Returns the rows as a text beside the arm, and a bar for each taxel on the back of its finger. `pressures` are
    those of the nine taxels of index, middle and thumb as fractions of a full bar; empty if unknown."""
    text_height_m = 0.03
    text_columns = 44
    text_at = (0.0, 0.5, 0.6)  # in the base, to the left of the arm, of a right one to the right [m]
    text = marker("text", Marker.TEXT_VIEW_FACING, 0, frames(BASE), LIFETIME)
    x, y, z = text_at
    text.pose.position, text.scale.z = Point(x, -y if frames.tf_prefix == RIGHT else y, z), text_height_m
    text.text = plain_text(rows, text_columns)
    tones = {row.tone for row in rows}
    colour = BRIGHT_COLOURS[next((tone for tone in WORST if tone in tones), RowTone.STALE)]
    text.color = ColorRGBA(*(int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 1.0)
    bars = [
        _bars(f"{part}_{finger + 1}", part, fractions, frames)
        for finger, taxels in enumerate(pressures)
        for part, fractions in (("proximal", taxels[:5]), ("distal", taxels[5:]))
    ]
    return MarkerArray([text, *bars])


def _bars(link: str, part: str, fractions: Sequence[float], frames: ArmFrames) -> Marker:
    bar_width_m = 0.004
    shortest_bar_m = 0.001
    longest_bar_m = 0.03
    bars = marker(f"touch {link}", Marker.LINE_LIST, 0, frames(f"reflex/{link}"), LIFETIME)
    bars.scale.x = bar_width_m
    back = TAXEL_POSITIONS[part].copy()
    back[:, 2] = EXTENT[part][0][2]
    for start, normal, fraction in zip(back, TAXEL_NORMALS[part], fractions):
        end = start - normal * (shortest_bar_m + fraction * longest_bar_m)
        bars.points += [Point(*start), Point(*end)]
        bars.colors += 2 * [ColorRGBA(*traffic_light(1.0 - fraction), 1.0)]
    bars.color = ColorRGBA(1.0, 1.0, 1.0, 1.0)
    return bars
