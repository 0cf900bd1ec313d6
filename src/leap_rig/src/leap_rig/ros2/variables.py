"""Environment variables of the process that speaks ROS 2, which decide what of the network it hears."""

from __future__ import annotations

from collections.abc import Mapping

from leap_rig.ros2.config import LOCALHOST

FOREIGN = ("PYTHONPATH", "PYTHONHOME", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH",
           "RMW_IMPLEMENTATION", "ROS_LOCALHOST_ONLY")  # fmt: skip
"""Variables of ROS 1, or of another ROS 2."""
NETWORK = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "ROS_SUPER_CLIENT", "RMW_", "FASTDDS_", "FASTRTPS_")
"""What the names of variables begin with that lead to other machines."""


def side_variables(own: Mapping[str, str], discovery: str, profile: str) -> dict[str, str]:
    """Returns the variables for a discovery. Those of LOCALHOST name the profile of Fast DDS that binds it to loopback:
    ROS 2's own range of that name answers each machine that has this one among its ROS_STATIC_PEERS."""
    variables = {name: value for name, value in own.items() if name not in FOREIGN}
    variables["LEAP_RIG_PYTHONPATH"] = own.get("PYTHONPATH", "")
    if discovery == LOCALHOST:
        variables = {name: value for name, value in variables.items() if not name.startswith(NETWORK)}
        variables.update(FASTDDS_DEFAULT_PROFILES_FILE=profile, SKIP_DEFAULT_XML_FILE="1")
    return {**variables, "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery.upper()}
