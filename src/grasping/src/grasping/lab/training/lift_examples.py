"""What episodes teach: a network of lifts, by each closing of the fingers, and a taste, by the operator's choice."""

from __future__ import annotations

import cv2
import numpy as np

from grasping.lab.dataset.episode import SHOWN, Episode, EpisodeFrame
from grasping.lab.dataset.labels import tilt_and_angle, windowed
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare
from grasping.poses.chooser import ImageMaps
from grasping.poses.gripper import Gripper
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import pixels_of
from grasping.poses.taste import Options, Shown


def image_maps(frame: EpisodeFrame) -> ImageMaps | None:
    """Returns what the camera saw and GG-CNN said of it, as it was recorded; None if the frame holds nothing."""
    try:
        image = prepare(frame.depth_m, Crop(0, 0, frame.crop.side))
    except ValueError:
        return None
    output = np.stack([cv2.resize(m.astype(np.float32), (NETWORK_SIDE, NETWORK_SIDE)) for m in frame.maps])
    return ImageMaps.of_output(image, windowed(frame.camera, frame.crop), output)


def attempt(episode: Episode, ggcnn: str, gripper: Gripper) -> tuple[np.ndarray, bool] | None:
    """Returns the features of an episode's grasp, shape (FEATURES,), and whether it held, seen from the frame in which
    the hand was farthest away. None where nothing was tried, the camera saw nothing, or the maps are not of GG-CNN's
    file of that SHA-256. A hand whose opening is unknown was as open as GG-CNN says there.
    """
    frame = episode.frame(int(np.argmax(episode.distance)))
    of, T = image_maps(frame), frame.T_camera_grasp[None]
    others = episode.metadata.source == SHOWN or episode.metadata.configuration.get("weights") != ggcnn
    if others or of is None or T[0, 2, 3] <= 0.0:
        return None
    rows, columns, scale = pixels_of(T[:, :3, 3], of.image, of.camera)
    opening = np.where(np.isnan(frame.opening), of.maps.width[rows, columns] * scale, frame.opening)
    return features(of.hypotheses(T, opening), of.image, of.camera, of.frame, gripper)[0], episode.held


def shown(episode: Episode, given: Options) -> Shown | None:
    """Returns the operator's grasp among the options of an episode's last frame; None where the camera cannot see it
    or it comes straight towards the camera."""
    frame = episode.frame(len(episode) - 1)
    T, R = frame.T_camera_grasp, given.of.frame.R
    if T[2, 3] <= 0.0:
        return None
    try:
        tilt, angle = tilt_and_angle(R.T @ T[:3, :3])
    except ValueError:
        return None
    return Shown(given, R.T @ T[:3, 3], angle, tilt, frame.opening)
