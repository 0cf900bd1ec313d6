"""The node leap_kuka_node with a fault: after SIGUSR1 each tracking frame raises an exception in its callback, after
the next one none does. `python -m campaign.planted_fault __name:=leap_kuka_node`"""

from __future__ import annotations

import signal
from typing import Any
from unittest import mock

from leap_kuka import teleop
from leap_kuka.ros.teleop_node import main


class PlantedFault:
    """Takes the place of ArmTeleop.step, which it calls while `on` is false."""

    def __init__(self) -> None:
        self.on = False
        self._step = teleop.ArmTeleop.step

    def toggle(self, *_: Any) -> None:
        """Begins to raise, or no longer does."""
        self.on = not self.on

    def step(self, *arguments: Any) -> Any:
        """As ArmTeleop.step."""
        if self.on:
            raise RuntimeError("planted")
        return self._step(*arguments)


if __name__ == "__main__":
    fault = PlantedFault()
    signal.signal(signal.SIGUSR1, fault.toggle)
    with mock.patch.object(teleop.ArmTeleop, "step", lambda *arguments: fault.step(*arguments)):
        main()
