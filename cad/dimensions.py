"""All numbers of the printed parts, in mm and degrees, each with its source. Needs no CadQuery.

A number without a source is a choice of this design. Parts on the arm are drawn in the frame of the media flange:
origin in the middle of its face, z out, as `kuka/flange` in tf. What the hand adds to the arm's tool follows from here.
"""

from __future__ import annotations

from dataclasses import dataclass

PRINTER = 220.0
"""Every part fits a cube of this edge: the bed of common printers."""

# --- Fits of a well-set printer with a 0.4 mm nozzle: check them on the first part ---
FIT = 0.1
"""Printed holes come out smaller and printed pins larger: a centring gets so much in diameter."""
MEMBRANE = 0.2
"""One layer closes a hole above a pocket that is printed over air; the screw or a drill opens it."""

# --- Screws ---
M4_HOLE, M5_HOLE, M6_HOLE = 4.5, 5.5, 6.6  # ISO 273, medium
M5_NUT_WIDTH, M5_NUT_HEIGHT = 8.0, 4.7  # ISO 4032
M6_NUT_WIDTH, M6_NUT_HEIGHT = 10.0, 5.2  # ISO 4032
NUT_PLAY = 0.25
"""A nut's pocket is so much wider than the nut, across its flats."""
M5_COUNTERSINK = 11.2  # ISO 10642: head of 10 mm at the sharp edge 11.2 mm, 90 deg
M6_WASHER, M6_WASHER_THICKNESS = 12.0, 1.6  # ISO 7089
M6_HEAD_HEIGHT = 6.0  # ISO 4762
M4_INSERT_HOLE, M4_INSERT_DEPTH = 5.6, 6.0  # usual heat-set insert M4 x 5; take the hole from the insert's own sheet
QUARTER_INSERT_HOLE, QUARTER_INSERT_DEPTH = 8.0, 13.5  # usual heat-set insert 1/4"-20 UNC x 12.7; likewise

# --- Media flange of the arm: DIN ISO 9409-1-50-7-M6 ---
FLANGE_CIRCLE = 50.0
FLANGE_SCREWS = (45.0, 135.0, 225.0, 315.0)
"""Four of the seven threads, which lie every 45 deg round the circle; the dowel's hole takes the eighth place."""
FLANGE_CENTRING = 31.5
FLANGE_OUTER = 63.0
FLANGE_BODY = 100.0  # rig_description: MEDIA_FLANGE_RADIUS
DOWEL_PILOT = 5.8
"""To be reamed to 6 H7."""
DOWEL_DEPTH = 9.0
DOWELS = (0.0, 90.0, 180.0, 270.0)
"""The dowel stands in one of these directions, whichever the arm's flange has: the parts take it in each."""

# --- Hand: ReFlex TakkTile ---
HAND_CIRCLE = 65.0  # three M6 countersunk bolts evenly spaced on this circle hold the back shell
HAND_BOLTS = (0.0, 120.0, 240.0)
HAND_LENGTH = 80.0  # from its mounting face to the tool's point, in kuka/tool_length
HAND_FOOT = 82.0  # rig_description: foot of the shell

# --- The two connectors, together CONNECTOR_LENGTH ---
CONNECTOR_LENGTH = 26.0  # kuka/tool_length 0.106 m less HAND_LENGTH
KUKA_CONNECTOR = 14.0
HAND_CONNECTOR = CONNECTOR_LENGTH - KUKA_CONNECTOR
CONNECTOR_OUTER = 86.0
SPIGOT = 4.0
"""How far a centring reaches into its bore."""
BORE = 24.0
"""Way for a plug of the hand's network cable (11.7 x 8 mm) and its cable."""
SCREW_FLOOR = 6.0
"""Left under the heads of the flange's screws."""
SCREW_POCKET = 13.0
JOINT_CIRCLE = 70.0
JOINT_SCREWS = (60.0, 180.0, 300.0)
JOINT_STEP = 30.0
"""The hand turns against the flange in steps of this: the first connector has a place for a nut at each."""
JOINT_NUT_POCKET = 5.0
FLANGE_SCREW, FLANGE_SCREW_WITH_RING, JOINT_SCREW = 16.0, 25.0, 25.0
"""Lengths: ISO 4762 M6 into the flange without and with the ring, ISO 10642 M5 between the connectors."""
FLANGE_THREAD = (6.0, 9.0)
"""Least and greatest reach of a screw into the flange: an assumption, to be compared with the arm's own manual."""
HAND_NUT_POCKET = 5.5
HAND_BORE = 42.0
CABLE_WIDTH, CABLE_DEPTH = 14.0, 9.0
CABLES = (90.0, 270.0)
MARK_WIDTH, MARK_DEPTH = 2.0, 1.5
"""Groove along the rim in the direction of the flange's x axis."""

# --- Ring of the tag, between flange and connectors ---
RING = 10.0
SLEEVE_LENGTH = 2 * SPIGOT
TOOL_LENGTH = CONNECTOR_LENGTH + HAND_LENGTH
TOOL_LENGTH_WITH_RING = TOOL_LENGTH + RING
ARM_WIDTH = 70.0
PAD_WIDTH, PAD_HEIGHT, PAD_THICKNESS = 116.0, 60.0, 8.0
PAD_FACE = 61.0
"""Distance of the pad's outer face from the flange's axis."""
PAD_SCREWS = ((-50.0, 17.0), (50.0, 17.0), (-50.0, 46.0), (50.0, 46.0))
"""Places in the flange's x and z: so far out that a straight key passes connectors and hand."""
PAD_SCREW = 12.0  # ISO 4762 M4
KEY = 8.0
"""Room for head and key, in diameter."""
GUSSET_WIDTH, GUSSET_TOP, GUSSET_ROOT = 6.0, 50.0, 35.0

# --- Tags: the printed sheet's face is what the camera sees ---
SHEET = 0.1
"""Self-adhesive paper or film."""
TAG_DISTANCE = 71.1  # drawing of the rig's first tag holder: tag's centre from the flange's axis, along its y axis
SINGLE_BEYOND = 43.5  # the same drawing: ring 10 mm + 33.5 mm beyond the flange's face
SINGLE_TAG = 97.0  # edge of the black square
SINGLE_PLATE = 125.0
SINGLE_SKIN = 4.0
SINGLE_RIB = 6.0
PANEL_BEYOND = 103.5
"""Centre of the large panel beyond the flange's face, 60 mm farther than the single tag's: at 43.5 mm its plate would
stand in the forearm. Its lower edge reaches 46.5 mm behind the face, clear of the wrist at every turn of joint 7."""
PANEL_MAX_JOINT_6 = 100.0
"""With the large panel joint 6 must not bend farther, in either direction: the forearm comes to its corner."""
PANEL_MAX_SPREAD = 10.0
"""With the large panel the hand's fingers must not spread farther."""
PANEL_PLATE, PANEL_THICKNESS = 300.0, 3.0
"""Bought: aluminium composite, 3 mm."""
PANEL_TAGS = ((0, 100.0, 0.0, 0.0), (1, 60.0, -105.0, 105.0), (2, 60.0, 105.0, 105.0), (3, 60.0, -105.0, -105.0),
              (4, 60.0, 105.0, -105.0))  # fmt: skip
"""Id, edge of the black square, x and y of its centre on the panel, of tag36h11."""
PANEL_SCREWS = ((-90.0, 0.0), (90.0, 0.0), (0.0, -90.0), (0.0, 90.0))
"""Between the tags and their white margins."""
PANEL_SHEET = 285.0
"""The corner tags with their white margins of one cell: what A3 paper can hold of the panel."""
A4, A3 = (210.0, 297.0), (420.0, 297.0)
RULER = 100.0
BRACKET_THICKNESS = TAG_DISTANCE - SHEET - PANEL_THICKNESS - PAD_FACE
BRACKET_BEAM = 40.0
BRACKET_END = 102.0

# --- Camera: ASUS Xtion Pro Live ---
XTION = (180.0, 50.0, 38.0)
"""Width, depth, height. Sources differ (178 to 180 wide, 35 to 38 high) and there is no drawing: nothing depends on the
width, and the jaw takes heights from XTION_LOWEST to XTION_HIGHEST."""
XTION_LOWEST, XTION_HIGHEST = 33.0, 41.0
CRADLE_WIDTH, CRADLE_PLAY = 80.0, 1.0
CRADLE_FLOOR = 20.0
CRADLE_LIP, CRADLE_LIP_HEIGHT = 4.0, 6.0
CRADLE_BACK, CRADLE_BACK_HEIGHT = 5.0, 28.0
FOOT_GAP, FOOT_DEPTH = 50.0, 5.0
"""Recess for what stays of the camera's foot."""
JAW_THICKNESS, JAW_REACH, JAW_SCREWS, JAW_SCREW_BELOW = 5.0, 34.0, 28.0, 23.0
JAW_FLANGE = 30.0

# --- Leap Motion controller ---
LEAP = (80.0, 30.0, 11.3)  # data sheet of the controller
LEAP_PLAY, LEAP_POCKET, LEAP_WALL = 0.6, 6.0, 6.0
LEAP_BASE = (150.0, 84.0, 8.0)
LEAP_CABLE = 14.0
LEAP_FEET = ((-66.0, -33.0), (-66.0, 33.0), (66.0, 0.0))
LEVEL_DIAMETER, LEVEL_DEPTH = 15.4, 5.0
"""Round bubble level, 15 mm; a usual size."""
LEVEL_PLACE = (0.0, -32.0)


@dataclass(frozen=True)
class Part:
    """One printed part.

    Attributes:
        title: what it is.
        low, high: opposite corners of its bounding box, in its own frame.
    """

    title: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]


def _round(diameter: float, bottom: float, top: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    radius = diameter / 2.0
    return (-radius, -radius, bottom), (radius, radius, top)


_CRADLE_DEPTH = XTION[1] / 2.0 + CRADLE_PLAY
PARTS = {
    "kuka_connector": Part("Connector on the arm's flange", *_round(CONNECTOR_OUTER, -SPIGOT, KUKA_CONNECTOR)),
    "hand_connector": Part("Connector on the hand's back shell", *_round(CONNECTOR_OUTER, 0.0, HAND_CONNECTOR)),
    "centring_sleeve": Part("Sleeve between flange and ring", *_round(FLANGE_CENTRING - FIT, 0.0, SLEEVE_LENGTH)),
    "marker_connector": Part(
        "Ring of the tag",
        (-PAD_WIDTH / 2.0, -CONNECTOR_OUTER / 2.0, 0.0),
        (PAD_WIDTH / 2.0, PAD_FACE, PAD_HEIGHT),
    ),
    "marker_plate": Part(
        "Plate of the single tag",
        (-SINGLE_PLATE / 2.0, -SINGLE_PLATE / 2.0, -(TAG_DISTANCE - SHEET - PAD_FACE)),
        (SINGLE_PLATE / 2.0, SINGLE_PLATE / 2.0, 0.0),
    ),
    "panel_bracket": Part(
        "Bracket of the panel with five tags",
        (-BRACKET_END, -PANEL_BEYOND, -BRACKET_THICKNESS),
        (BRACKET_END, BRACKET_END, 0.0),
    ),
    "camera_holder": Part(
        "Cradle of the camera on a tripod",
        (-CRADLE_WIDTH / 2.0, -_CRADLE_DEPTH - CRADLE_LIP, -CRADLE_FLOOR),
        (CRADLE_WIDTH / 2.0, _CRADLE_DEPTH + CRADLE_BACK, CRADLE_BACK_HEIGHT),
    ),
    "camera_jaw": Part(
        "Jaw of the camera's cradle",
        (-CRADLE_WIDTH / 2.0, -JAW_REACH, -JAW_FLANGE),
        (CRADLE_WIDTH / 2.0, CRADLE_BACK + JAW_THICKNESS, JAW_THICKNESS),
    ),
    "leap_holder": Part(
        "Level holder of the Leap Motion controller",
        (-LEAP_BASE[0] / 2.0, -LEAP_BASE[1] / 2.0, 0.0),
        (LEAP_BASE[0] / 2.0, LEAP_BASE[1] / 2.0, LEAP_BASE[2] + LEAP_POCKET),
    ),
}
