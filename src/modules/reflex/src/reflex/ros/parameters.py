"""Schema of the driver's private parameters: config/reflex_takktile.yaml and the addresses of the launch file."""

from __future__ import annotations

from dataclasses import Field, dataclass, fields, make_dataclass
from typing import Any

from common.config import flag, integer, number, text, vector
from reflex.conversions import MOTORS
from reflex.settings import HandSettings


@dataclass(frozen=True)
class HandAddresses:
    """Parameters beside the settings of `HandSettings`."""

    network_interface: str = text("interface on which the hand is, such as eth0; lo for the simulated hand")
    port: int = integer(low=1, high=65535, doc="UDP port of hand and host")
    calibration_folder: str = text("where calibrations are kept; may begin with ~")
    hold_at_exit: bool = flag("keep torque and goals when the driver exits", absent=False)

    def faults(self) -> list[str]:
        """Returns what is wrong beyond the range of single fields: travel above what the hand's fingers can do."""
        return [
            f"travel of {name} is {value:g} rad; the hand has {most:g} rad at most."
            for name, value, most in zip(MOTORS, self.settings().travel, HandSettings.travel)
            if value > most
        ]

    def settings(self) -> HandSettings:
        values = {field.name: getattr(self, field.name) for field in fields(HandSettings)}
        vectors = {name: tuple(value.tolist()) for name, value in values.items() if hasattr(value, "tolist")}
        return HandSettings(**{**values, **vectors})


def _schema(setting: Field) -> Any:
    if isinstance(setting.default, tuple):
        return vector(len(setting.default), **setting.metadata)
    return (integer if isinstance(setting.default, int) else number)(**setting.metadata)


ReflexDriverConfig: type[HandAddresses] = make_dataclass(
    "ReflexDriverConfig",
    [(setting.name, setting.type, _schema(setting)) for setting in fields(HandSettings)],
    bases=(HandAddresses,),
    frozen=True,
)
"""Parameters of the driver: the addresses, then the settings; vectors of four are f1, f2, f3, preshape."""
