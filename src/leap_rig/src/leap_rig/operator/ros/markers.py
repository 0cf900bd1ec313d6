"""The operator's view for RViz: rows and pressure on the robot's fingers as markers, and the thinned point cloud."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rospy
from geometry_msgs.msg import Point
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE, ONE_ARM, ArmFrames
from common.hand_tracking import LEFT, RIGHT
from common.numbers import LABEL_M
from common.operator_rows import BRIGHT_COLOURS, Row, RowTone, plain_text
from leap_motion.ros.hand_markers import marker
from leap_motion.skeleton import traffic_light
from rig_description.hand import EXTENT, TAXEL_NORMALS, TAXEL_POSITIONS

LIFETIME = rospy.Duration.from_sec(1.0)  # a marker that is not renewed vanishes; the rows come every 0.5 s
WORST = (RowTone.FAULT, RowTone.WARNING, RowTone.GOOD, RowTone.NORMAL, RowTone.STALE)


def view_markers(rows: Sequence[Row], pressures: Sequence[Sequence[float]], frames: ArmFrames = ONE_ARM) -> MarkerArray:
    """Returns the rows as a text beside the arm, and a bar for each taxel on the back of its finger. `pressures` are
    those of the nine taxels of index, middle and thumb as fractions of a full bar; empty if unknown."""
    text_columns = 32
    # In the base, middle of the last line: to the left of an only arm, over each of two and away from the other [m].
    x, y, z = {LEFT: (0.0, 0.05, 1.1), RIGHT: (0.0, -0.05, 1.1)}.get(frames.tf_prefix, (0.0, 0.6, 0.35))
    text = marker("text", Marker.TEXT_VIEW_FACING, 0, frames(BASE), LIFETIME)
    text.text = plain_text(rows, text_columns)
    text.pose.position, text.scale.z = Point(x, y, z + 0.5 * LABEL_M * text.text.count("\n")), LABEL_M
    tones = {row.tone for row in rows}
    colour = BRIGHT_COLOURS[next((tone for tone in WORST if tone in tones), RowTone.STALE)]
    text.color = ColorRGBA(*(int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 1.0)
    bars = [
        _bars(f"{part}_{finger + 1}", part, fractions, frames)
        for finger, taxels in enumerate(pressures)
        for part, fractions in (("proximal", taxels[:5]), ("distal", taxels[5:]))
    ]
    return MarkerArray([text, *bars])


def cloud_message(header: Header, points: np.ndarray, colours: np.ndarray) -> PointCloud2:
    """Returns the cloud of points, shape (n, 3) [m], with colours, shape (n, 3), bytes of red, green, blue."""
    rgb = np.zeros((len(points), 4), dtype=np.uint8)
    rgb[:, 2::-1] = colours
    data = np.hstack([points.astype("<f4").view(np.uint8).reshape(-1, 12), rgb]).tobytes()
    fields = [PointField(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate(("x", "y", "z", "rgb"))]
    return PointCloud2(header, 1, len(points), fields, False, 16, 16 * len(points), data, True)


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
