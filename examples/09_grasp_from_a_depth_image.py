"""Finds the best grasp in a depth image with the network of this repository; the image is a box on a table."""

from pathlib import Path

import numpy as np

from common.camera_model import pinhole
from grasping.network import weights
from grasping.pipeline.pipeline import GraspPipeline, PipelineSettings
from grasping.pipeline.view import CameraView, CropConfig

depth = np.full((480, 640), 0.70, np.float32)  # [m]
depth[215:265, 260:380] = 0.62  # the box
camera = pinhole("camera", 640, 480, [[525.0, 0.0, 319.5], [0.0, 525.0, 239.5], [0.0, 0.0, 1.0]])
network = weights.load((Path(__file__).parents[1] / "src/grasping/weights/ggcnn2_wide.pt").read_bytes()).network
found = GraspPipeline(CameraView(CropConfig(400, 0)), network, PipelineSettings(count=1)).step(depth, camera)
grasp = found.candidates[0].grasp
print("position before the camera [m]:", grasp.T_camera_grasp[:3, 3].round(3))
print(f"angle {np.degrees(grasp.angle):.0f} deg, opening {1000 * grasp.width:.0f} mm, quality {grasp.quality:.2f}")
