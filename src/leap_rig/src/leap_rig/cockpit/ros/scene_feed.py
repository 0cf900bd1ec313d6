"""What the cockpit's scene shows, from the topics that RViz's presets show."""

from __future__ import annotations

from leap_rig.cockpit.scene import SceneServer


class SceneFeed:
    """Listens between `start` and `stop`, as long as somebody looks, and passes on what changes visibly."""

    def __init__(self, scene: SceneServer) -> None:
        self._scene = scene

    def start(self) -> None:
        """Subscribes; no effect while it is started."""

    def stop(self) -> None:
        """Unsubscribes; what was shown last stays in the scene."""
