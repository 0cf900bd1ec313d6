"""The hand that steers Leap Rig as a teleoperator of LeRobot: `--teleop.type=leap_rig`.

The hand moves the arm by the rig itself; LeRobot only learns where to: the desired tool and the commanded fingers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from leap_rig_link import ACTION, RigLink
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig


@TeleoperatorConfig.register_subclass("leap_rig")
@dataclass(kw_only=True)
class LeapRigTeleoperatorConfig(TeleoperatorConfig):
    """Options of the command line."""

    socket: str = ""  # empty: where lerobot_server.py listens by itself


class LeapRigTeleoperator(Teleoperator):
    """The operator's hand, by lerobot_server.py."""

    config_class = LeapRigTeleoperatorConfig
    name = "leap_rig"

    def __init__(self, config: LeapRigTeleoperatorConfig) -> None:
        self._link = RigLink(config.socket)  # first: the base class asks for it when it is destroyed
        super().__init__(config)

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(ACTION, float)

    @property
    def feedback_features(self) -> dict[str, Any]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._link.is_connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        self._link.connect()

    def calibrate(self) -> None:
        """The rig does it by its own programs."""

    def configure(self) -> None:
        """The rig is configured by its own parameters."""

    def get_action(self) -> dict[str, Any]:
        return self._link.ask("intent")[0]["action"]

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """A bare hand feels nothing."""

    def disconnect(self) -> None:
        self._link.close()
