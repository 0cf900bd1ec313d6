"""Finds grasps in depth images: .npy or .tiff in metres, or 16-bit images in millimetres, 0 or NaN = no reading.

Writes one JSON object a grasp, best first: position before the camera [m], angle in the image [rad], width [m],
quality, pixel, and for a folder the image's name. The image's centre is taken for the optical axis unless --centre says
otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from torch import nn

from common.camera_model import pinhole
from common.command_line import real, whole
from common.errors import RigError
from common.plausible import check_intrinsics
from grasping.lab.dataset.labelled_images import depth_images, read_depth
from grasping.lab.synthetic.samples import FOCAL_PX
from grasping.network import weights
from grasping.network.maps import HANDS, THRESHOLD
from grasping.network.networks import FLOAT32, PRECISIONS
from grasping.pipeline.pipeline import GraspPipeline, PipelineResult, PipelineSettings
from grasping.pipeline.projection import CameraGrasp
from grasping.pipeline.view import CameraView, CropConfig


def drawn(found: PipelineResult) -> np.ndarray:
    """Returns the network's image with the grasps: a line from finger to finger, shape (900, 900, 3), uint8."""
    assert found.view is not None, "a result with a view is drawn"
    depth = found.view.image.depth
    grey = (255.0 * (depth.max() - depth) / max(1e-6, float(np.ptp(depth)))).astype(np.uint8)
    image = cv2.resize(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), (900, 900), interpolation=cv2.INTER_NEAREST)
    for peak in (candidate.peak for candidate in found.candidates):
        half = 0.5 * peak.width * np.array([np.cos(peak.angle), -np.sin(peak.angle)])
        start, end = (
            (3.0 * (np.array([peak.column, peak.row]) + sign * half + 0.5)).astype(int).tolist() for sign in (-1.0, 1.0)
        )
        cv2.line(image, start, end, (0, 200, 0), 3)
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("depth", type=Path, help="depth image, or a folder of them")
    parser.add_argument("weights", type=Path, help="weight file of a network")
    parser.add_argument("--focal", type=real(1.0, 1e5), default=FOCAL_PX, help=f"focal length [px], default {FOCAL_PX}")
    parser.add_argument("--centre", type=real(-1e5, 1e5), nargs=2, metavar=("CX", "CY"), help="optical axis [px]")
    parser.add_argument(
        "--crop", type=whole(1, 16384), default=400, help="side of the window in the middle [px], default 400"
    )
    parser.add_argument("--hand", choices=HANDS, help="refuse weights that were trained for another hand")
    parser.add_argument("--count", type=whole(1, 50), default=1, help="most grasps of an image")
    parser.add_argument("--precision", choices=PRECISIONS, default=FLOAT32, help="of the network's convolutions")
    picture_help = "write the network's image with the grasps to this file, or for a folder to this folder"
    parser.add_argument("--picture", type=Path, help=picture_help)
    arguments = parser.parse_args()
    many = arguments.depth.is_dir()
    try:
        paths = depth_images(arguments.depth) if many else [arguments.depth]
        loaded = weights.load(arguments.weights.read_bytes())
        mismatch = arguments.hand and loaded.mismatch(arguments.hand)
        if mismatch:
            raise RigError(f"{arguments.weights}: {mismatch}")
        network = loaded.network
        if many and arguments.picture is not None:
            arguments.picture.mkdir(parents=True, exist_ok=True)
        left_out = 0
        for path in paths:
            try:
                found = find(path, network, arguments)
            except (RigError, ValueError, cv2.error) as error:
                if not many:
                    raise
                sys.stderr.write(f"Left out: {error}\n")
                left_out += 1
                continue
            for grasp in (candidate.grasp for candidate in found.candidates):
                if grasp is not None:
                    name = {"image": path.name} if many else {}
                    place = grasp.T_camera_grasp[:3, 3].tolist()
                    sys.stdout.write(json.dumps({**name, "position": place, **_plain(grasp)}) + "\n")
            if arguments.picture is not None:
                picture = arguments.picture / f"{path.stem}.png" if many else arguments.picture
                if not cv2.imwrite(str(picture), drawn(found)):
                    raise RigError(f"{picture} cannot be written.")
        if left_out == len(paths):
            raise RigError(f"None of the {left_out} images in {arguments.depth} can be used.")
    except (RigError, ValueError, OSError, cv2.error) as error:
        parser.error(str(error))


def find(path: Path, network: nn.Module, arguments: argparse.Namespace) -> PipelineResult:
    """Returns the grasps in one image; raises RigError or ValueError if there is none to see."""
    depth = read_depth(path)
    h, w = depth.shape
    cx, cy = arguments.centre or (0.5 * (w - 1), 0.5 * (h - 1))
    camera = pinhole("camera", w, h, [[arguments.focal, 0.0, cx], [0.0, arguments.focal, cy], [0.0, 0.0, 1.0]])
    check_intrinsics(camera.K, w, h, off_centre=np.inf)  # the image may be a part of the camera's
    threshold = None if arguments.count == 1 else THRESHOLD
    settings = PipelineSettings(count=arguments.count, threshold=threshold, precision=arguments.precision)
    found = GraspPipeline(CameraView(CropConfig(arguments.crop, 0)), network, settings).step(depth, camera)
    if found.view is None:
        raise RigError(f"{path}: {found.reason}")
    return found


def _plain(grasp: CameraGrasp) -> dict:
    return {name: getattr(grasp, name) for name in ("angle", "width", "quality", "pixel")}
