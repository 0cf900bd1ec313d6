"""Where the rig's ReFlex hand can take hold of what lies on the table: two fingers against the thumb, from above.

The hand comes down half closed and closes until all fingers press. In the map, turned until they close along the rows
and cut at the height of the tips' pads, the first thing in the strip of each finger is its contact. A grasp holds when
thumb and fingers meet opposite faces. A label stands for the line, not for the side of the thumb: the worse of both.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from grasping.lab.synthetic.labels import FREE, LEVEL_M, LOWEST_OBJECT_M, Grasps, around, in_directions

ONE_FINGER = 0.7  # value of a grasp of which only one finger meets the object, against both
FLAT_M = 0.0115  # pads that reach less far below what they grasp slide over a round edge
UPRIGHT = 0.72  # a face that reaches this fraction of its height, as a mean of its first two cells, is not round
SLIDING = 0.25  # value of a grasp that may slide over


class Hand(NamedTuple):
    """The ReFlex hand as the rig closes it; depths are below its base; all in metres but the friction."""

    above: float = 0.150  # of the base over the surface between the fingers
    ground: float = 0.200  # least height of the base over the table
    palm: float = 0.089  # depth of the palm's face
    tips: float = 0.191  # depth of the half-closed fingers' lowest points
    pads: float = 0.187  # greatest depth at which the pads of the closing tips press sideways
    preshape: float = 0.058  # half the distance between the half-closed pads
    finger: float = 0.020  # of a half-closed finger along the closing direction
    breadth: float = 0.012  # of a pad across it, as far as it presses
    spread: float = 0.026  # of each of the two fingers from the middle, where the thumb is
    palm_size: tuple[float, float] = (0.130, 0.100)  # along the closing direction and across it
    clearance: float = 0.005  # on each side between object and pad when the hand comes down
    friction: float = 1.1  # coefficient of the rubber
    margin: float = 0.0  # added to the opening of a label, as far as the hand opens


def grasps(surface: np.ndarray, table: np.ndarray, cell: float, hand: Hand, directions: int = 12) -> Grasps:
    """Returns the score and opening of a grasp at each cell, as `labels.grasps`; the maps are along the vertical."""
    margin = _margin(cell, hand)
    return in_directions(surface, table, margin, directions, lambda s, t: along_rows(s, t, cell, hand))


def _margin(cell: float, hand: Hand) -> int:
    return int(np.ceil(max(hand.preshape + 1.5 * hand.finger, 0.5 * max(hand.palm_size)) / cell) + 2)


def along_rows(surface: np.ndarray, table: np.ndarray, cell: float, hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """Returns score and opening [m] of the grasps whose fingers close along the rows."""
    margin = _margin(cell, hand)
    surface, table = (
        cv2.copyMakeBorder(v.astype(np.float32), *4 * (margin,), cv2.BORDER_CONSTANT, value=(FREE,))
        for v in (surface, table)
    )
    score, opening = np.zeros_like(surface), np.zeros_like(surface)
    base = np.minimum(surface - hand.above, table - hand.ground)
    level = np.round((base + hand.pads) / LEVEL_M).astype(int)
    objects = (surface < table - LOWEST_OBJECT_M) & (surface < LEVEL_M * level)
    for wanted in np.unique(level[objects]):
        here = objects & (level == wanted)
        window = around(here, (margin, margin))
        assert window is not None, "a level holds cells"
        y, x = np.nonzero(here[window])
        score[window][y, x], opening[window][y, x] = _at_level(surface[window], wanted * LEVEL_M, y, x, cell, hand)
    inside = slice(margin, -margin), slice(margin, -margin)
    return score[inside], opening[inside]


def _at_level(
    surface: np.ndarray, cut: float, y: np.ndarray, x: np.ndarray, cell: float, hand: Hand
) -> tuple[np.ndarray, np.ndarray]:
    """Returns score and opening [m] of the grasps at cells (y, x), each shape (m,), whose pads press at depth `cut`."""
    one_blocked = 0.5  # of one where a finger comes down on something
    centring_loss = 0.2  # greatest loss beside the middle
    lean_loss = 0.5  # and at the edge of the friction cone
    reach, aside, half = (round(v / cell) for v in (hand.preshape, hand.spread, 0.5 * hand.breadth))
    width = round(hand.finger / cell)
    foot = np.ones((2 * half + 3, 2 * (width // 2) + 1), np.uint8)
    palm = np.ones([2 * int(0.5 * size / cell) + 1 for size in hand.palm_size[::-1]], np.uint8)
    top = cv2.erode(surface, np.ones((2 * half + 1, 1), np.uint8))  # the highest across a pad
    before, after = _nearest(top < cut)
    in_the_way = cv2.dilate((surface < cut - hand.pads + hand.tips).astype(np.uint8), foot) > 0
    free = cv2.dilate((surface < cut - hand.pads + hand.palm).astype(np.uint8), palm)[y, x] == 0
    flat = cut - surface[y, x] < FLAT_M
    out = reach + width // 2  # where the fingers come down
    rows = y, y + aside, y - aside
    scores, widest = [], np.zeros(len(y))
    for side in (1, -1):  # on which the two fingers are
        ends = (after, before, before) if side > 0 else (before, after, after)
        signs = -side, side, side
        starts = [x + sign * reach for sign in signs]
        contacts = [end[row, start] for end, row, start in zip(ends, rows, starts)]
        thumb, *fingers = (sign * (contact - x) for contact, sign in zip(contacts, signs))
        rises = [_rise(top, cut, row, c, -sign) for row, c, sign in zip(rows, contacts, signs)]
        leans = [_lean(rise, cell) for rise in rises]
        blocked = sum(in_the_way[row, x + sign * out].astype(int) for row, sign in zip(rows, signs))
        # A finger that would pass the thumb before it meets anything passes beside the object.
        meets = [finger + thumb > 0 for finger in fingers]
        pair = meets[0] & meets[1]
        value = np.where(pair, 1.0, np.where(meets[0] | meets[1], ONE_FINGER, 0.0))
        far = np.max([thumb, *(np.where(met, finger, thumb) for met, finger in zip(meets, fingers))], axis=0)
        near = np.min([thumb, *(np.where(met, finger, thumb) for met, finger in zip(meets, fingers))], axis=0)
        value = value * (1.0 - centring_loss * np.clip((far - near) / reach, 0.0, 1.0))
        slopes = [_slope(*met) for met in zip(ends, rows, starts, contacts)]
        # Two fingers settle on a face by both contacts, whatever lies between them.
        chord = np.abs(fingers[0] - fingers[1]) / (2.0 * aside)
        slopes[1:] = [np.where(pair, np.minimum(chord, slope), slope) for slope in slopes[1:]]
        worst = [np.hypot(lean, slope) for lean, slope in zip(leans, slopes)]
        lean = np.max([worst[0], *(np.where(met, v, 0.0) for met, v in zip(meets, worst[1:]))], axis=0)
        value = value * np.where(lean < hand.friction, 1.0 - lean_loss * lean / hand.friction, 0.0)
        rounded = [rise[:2].mean(axis=0) < UPRIGHT * rise.max(axis=0) for rise in rises]
        slides = flat & np.any([rounded[0], *(met & of for met, of in zip(meets, rounded[1:]))], axis=0)
        value = value * np.where(slides, SLIDING, 1.0)
        scores.append(value * np.where(blocked == 0, 1.0, np.where(blocked == 1, one_blocked, 0.0)))
        widest = np.maximum(widest, far)
    score = np.where(free, np.minimum(*scores), 0.0)
    opening = 2.0 * (widest + 0.5) * cell + 2.0 * hand.clearance + hand.margin
    return score, np.where(score > 0.0, np.minimum(opening, 2.0 * hand.preshape), 0.0)


def _nearest(occupied: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns, for each cell, the last occupied column up to it and the first one from it on; far outside if none."""
    last = occupied.shape[1]
    column = np.arange(last)
    before = np.maximum.accumulate(np.where(occupied, column, -last), axis=1)
    after = np.minimum.accumulate(np.where(occupied, column, 2 * last)[:, ::-1], axis=1)[:, ::-1]
    return before, after


def _slope(ends: np.ndarray, row: np.ndarray, start: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Returns the tangent of the angle between faces and fingers at contacts, seen from above, on the straighter side.
    `ends`: column of the first thing that a finger meets from column `start` of a row.
    """
    slope_cells = 4  # rows to the side of a contact over which its face's direction is taken
    beside = [np.abs(ends[row + k, start] - contact) for k in (-slope_cells, slope_cells)]
    return np.minimum(*beside) / slope_cells


def _rise(top: np.ndarray, cut: float, row: np.ndarray, contact: np.ndarray, inwards: int) -> np.ndarray:
    """Returns how far faces rise above the cut at their contacts and over the next four cells, shape (5, m) [m]."""
    column = np.clip(contact, 4, top.shape[1] - 5)
    return cut - np.stack([top[row, column + k * inwards] for k in range(5)])


def _lean(rise: np.ndarray, cell: float) -> np.ndarray:
    """Returns the tangent of the angle by which faces lean inwards, from their rise over two cells; a face that reaches
    its top so soon is upright.
    """
    soon, full = rise[1:3].max(axis=0), rise[1:].max(axis=0)
    return np.where(soon > 0.8 * full, 0.0, 2.0 * cell / np.maximum(soon, 1e-6))
