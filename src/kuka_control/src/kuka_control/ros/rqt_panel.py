"""The control panel as a plugin of rqt; only rqt imports this module."""

from __future__ import annotations

from qt_gui.plugin import Plugin

from kuka_control.gui.panel import ControlPanel
from kuka_control.ros.panel_link import PanelLink


class ControlPanelPlugin(Plugin):
    """Puts a panel into rqt's window and disconnects it when the operator closes it."""

    def __init__(self, context) -> None:
        super().__init__(context)
        self.setObjectName("ControlPanelPlugin")
        self._panel = ControlPanel()
        if context.serial_number() > 1:  # rqt expects the titles of several panels to differ
            self._panel.setWindowTitle(f"{self._panel.windowTitle()} ({context.serial_number()})")
        self._link = PanelLink(self._panel)
        context.add_widget(self._panel)

    def shutdown_plugin(self) -> None:
        self._link.close()
