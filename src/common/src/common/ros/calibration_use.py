"""Whether a node may use a calibration: what it says of simulated devices, to the rig that is there."""

from __future__ import annotations

import rospy

from common.errors import ConfigError
from common.simulated import doubt, refusal


def check_use(what: str, simulated: bool | None, rig_simulated: bool | None, cure: str) -> None:
    """Raises ConfigError for a simulated calibration on a real rig, and warns of one that does not say what it is;
    arguments as of `refusal`."""
    why = refusal(what, simulated, rig_simulated, cure)
    if why:
        raise ConfigError([why])
    asked = doubt(what, simulated, rig_simulated)
    if asked:
        rospy.logwarn("%s", asked)
