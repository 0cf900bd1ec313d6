"""A copy of the simulated world that follows the original through its control port."""

from __future__ import annotations

import mujoco

from common.errors import ConfigError, DeviceError
from rig_simulation.control_port import ControlClient
from rig_simulation.world.model import WorldDescription, build_model


class WorldCopy:
    """The model of the world in the state of the last snapshot.

    Args:
        client: of the world's control port.

    Attributes:
        model, data: of MuJoCo, after the first `follow`; new after a change of the scene.
    """

    def __init__(self, client: ControlClient) -> None:
        self._client = client
        self._load: int | None = None
        self.model: mujoco.MjModel
        self.data: mujoco.MjData

    def follow(self) -> bool:
        """Copies the present state of the world; returns whether the model is new.

        Raises:
            DeviceError: the world gives no valid answer; the next call rebuilds the model.
        """
        try:
            snapshot = self._client.ask("snapshot")
            new = snapshot["loads"] != self._load
            if new:
                self._load = self._build()
                snapshot = self._client.ask("snapshot")
            self.data.qpos[:] = snapshot["qpos"]
        except DeviceError:
            self._load = None
            raise
        except (KeyError, TypeError, ValueError, FileNotFoundError, ConfigError) as error:
            self._load = None
            reason = f"{type(error).__name__}: {error}"
            raise DeviceError(
                f"The simulated world gave an invalid answer: {reason}. Is it of another version?"
            ) from None
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return new

    def _build(self) -> int:
        fields = self._client.ask("scene")
        self.model = build_model(WorldDescription.from_fields(fields))
        self.data = mujoco.MjData(self.model)
        return fields["loads"]
