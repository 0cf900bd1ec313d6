"""What a network of lifts learns from episodes: each closing of the fingers was an attempt."""

from __future__ import annotations

import cv2
import numpy as np

from grasping.lab.dataset.episode import SHOWN, Episode, EpisodeFrame
from grasping.lab.dataset.labels import windowed
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare
from grasping.network.maps import smoothed
from grasping.pipeline.refined_grasp import SMOOTHING
from grasping.poses.chooser import ImageMaps
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import Hypotheses, pixels_of, said_of


def image_maps(frame: EpisodeFrame) -> ImageMaps | None:
    """Returns what the camera saw and GG-CNN said of it, as it was recorded; None if the frame holds nothing."""
    try:
        image = prepare(frame.depth_m, Crop(0, 0, frame.crop.side))
    except ValueError:
        return None
    output = np.stack([cv2.resize(m.astype(np.float32), (NETWORK_SIDE, NETWORK_SIDE)) for m in frame.maps])
    maps = smoothed(output, image.valid, SMOOTHING)
    return ImageMaps(image, windowed(frame.camera, frame.crop), maps, np.hypot(output[1], output[2]))


def attempt(episode: Episode, ggcnn: str) -> tuple[np.ndarray, bool] | None:
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
    level = of.frame()
    seen = said_of(T, opening, of.maps, of.certainty, of.image, of.camera, level)
    return features(Hypotheses(T, opening, seen), of.image, of.camera, level)[0], episode.held
