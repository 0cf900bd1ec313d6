"""Leap Rig as a robot of LeRobot: `--robot.type=leap_rig`.

Observed are joints, torques, fingers, tool and images; an action is the desired tool and the fingers. It moves the arm
only where lerobot_server.py runs with --moves; else the hand does, and what LeRobot sends is only recorded."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from leap_rig_link import ACTION, STATE, RigLink, RigLinkError, finite_action
from lerobot.robots import Robot, RobotConfig


@RobotConfig.register_subclass("leap_rig")
@dataclass(kw_only=True)
class LeapRigRobotConfig(RobotConfig):
    """Options of the command line, `--robot.images='{color: [480, 640]}'`, to which they are scaled."""

    socket: str = ""  # empty: where lerobot_server.py listens by itself
    images: dict[str, list[int]] = field(default_factory=lambda: {"color": [480, 640]})  # height, width


class LeapRigRobot(Robot):
    """The arm, its hand and cameras, by lerobot_server.py."""

    config_class = LeapRigRobotConfig
    name = "leap_rig"

    def __init__(self, config: LeapRigRobotConfig) -> None:
        self._link = RigLink(config.socket)  # first: the base class asks for it when it is destroyed
        super().__init__(config)
        self.config = config
        self._refused = ""

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        images = {name: (height, width, 3) for name, (height, width) in self.config.images.items()}
        return {**dict.fromkeys(STATE, float), **images}

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(ACTION, float)

    @property
    def is_connected(self) -> bool:
        return self._link.is_connected

    @property
    def is_calibrated(self) -> bool:
        return True

    @property
    def cameras(self) -> dict[str, Any]:
        """LeRobot's recorder counts them for its threads of images."""
        return self.config.images

    def connect(self, calibrate: bool = True) -> None:
        self._link.connect()

    def calibrate(self) -> None:
        """The rig does it by its own programs."""

    def configure(self) -> None:
        """The rig is configured by its own parameters."""

    def get_observation(self) -> dict[str, Any]:
        said, images = self._link.ask("observe")
        observation: dict[str, Any] = {name: float(said["state"][name]) for name in STATE}
        for name, shape in self.config.images.items():
            if name not in images:
                raise RigLinkError(f"The rig sends no images of {name}; name its topic with --camera of its server.")
            image = cv2.imdecode(np.frombuffer(images[name], np.uint8), cv2.IMREAD_COLOR)
            height, width = shape
            if image is None or min(shape) < 1 or abs(image.shape[0] * width / image.shape[1] - height) > 1.0:
                seen = "damaged" if image is None else f"{image.shape[0]} x {image.shape[1]}"
                raise RigLinkError(f"The image of {name} is {seen}, but {height} x {width} is configured.")
            scaled = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
            observation[name] = cv2.cvtColor(scaled, cv2.COLOR_BGR2RGB)
        return observation

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        wanted = finite_action(action)
        if not self._link.moves:
            return self._link.ask("intent")[0]["action"]
        refused = self._link.ask("act", action=wanted)[0]["refused"]
        if refused and refused != self._refused:
            logging.warning(refused)
        self._refused = refused
        return self._link.ask("intent")[0]["action"] if refused else wanted

    def disconnect(self) -> None:
        self._link.close()
