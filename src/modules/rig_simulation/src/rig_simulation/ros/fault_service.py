"""The service `simulation/fault`: switches the faults of all simulated devices.

It passes the request to the control port of the device, which knows its own faults.
"""

from __future__ import annotations

import math

import rospy

from common.errors import DeviceError
from common.ros.params import private_config
from rig_msgs.srv import SimulationFault, SimulationFaultRequest, SimulationFaultResponse
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import FaultServiceConfig

NAME = "simulation_faults"
TIMEOUT_S = 2.0


class FaultService:
    """Offers the service."""

    def __init__(self, config: FaultServiceConfig) -> None:
        ports = {
            "arm": config.arm_port,
            "leap": config.leap_port,
            "hand": config.hand_port,
            "camera": config.camera_port,
        }
        self._devices = {name: ControlClient(config.host, port, TIMEOUT_S) for name, port in ports.items()}
        rospy.Service("simulation/fault", SimulationFault, self._switch)

    def _switch(self, request: SimulationFaultRequest) -> SimulationFaultResponse:
        if request.device not in self._devices:
            known = ", ".join(self._devices)
            return SimulationFaultResponse(False, f"Unknown device {request.device!r}; the devices are {known}.")
        for name in ("value", "duration"):
            if not math.isfinite(getattr(request, name)):
                return SimulationFaultResponse(False, f"The {name} {getattr(request, name)} is not a finite number.")
        try:
            message = self._ask(self._devices[request.device], request)
        except DeviceError as error:
            return SimulationFaultResponse(False, str(error))
        rospy.loginfo("Faults of the simulated %s: %s", request.device, message)
        return SimulationFaultResponse(True, message)

    @staticmethod
    def _ask(device: ControlClient, request: SimulationFaultRequest) -> str:
        if not request.fault:
            listed = device.ask("faults")["faults"]
            return " ".join(f"{fault['name']}: {fault['doc']}{' (on)' if fault['on'] else ''}." for fault in listed)
        numbers = {"value": request.value or None, "duration": request.duration or None}
        active = device.ask("fault", name=request.fault, on=request.on, **numbers)["active"]
        return f"on: {', '.join(active)}." if active else "no fault is on."


def main() -> None:
    """Runs the node with its private parameters."""
    FaultService(private_config(FaultServiceConfig))
    rospy.spin()
