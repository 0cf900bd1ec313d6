"""The control panel as a plugin of rqt, with stand-ins for the parts of rqt that it touches."""

from __future__ import annotations

import importlib
import sys
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy

from rig_msgs.msg import KukaStatus

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
pytestmark = pytest.mark.ros

PACKAGE = Path(__file__).parents[1]


class Context:
    """What rqt gives to a plugin."""

    def __init__(self, number):
        self.number, self.widgets = number, []

    def serial_number(self):
        return self.number

    def add_widget(self, widget):
        self.widgets.append(widget)


@pytest.fixture
def plugin_class(monkeypatch, application):
    """The class that plugin.xml names, as rqt loads it."""
    from python_qt_binding.QtCore import QObject

    class Plugin(QObject):
        def __init__(self, context):
            super().__init__()
            self.context = context

    stand_in = types.ModuleType("qt_gui.plugin")
    stand_in.Plugin = Plugin
    monkeypatch.setitem(sys.modules, "qt_gui", types.ModuleType("qt_gui"))
    monkeypatch.setitem(sys.modules, "qt_gui.plugin", stand_in)
    module, name = described().get("type").rsplit(".", 1)
    monkeypatch.delitem(sys.modules, module, raising=False)
    loaded = getattr(importlib.import_module(module), name)
    assert issubclass(loaded, Plugin)
    yield loaded
    monkeypatch.delitem(sys.modules, module)


def described():
    export = ElementTree.parse(PACKAGE / "package.xml").find("export/rqt_gui")
    file = Path(export.get("plugin").replace("${prefix}", str(PACKAGE)))
    library = ElementTree.parse(file).getroot()
    assert (file.parent / library.get("path") / "kuka_control" / "ros" / "rqt_panel.py").is_file()
    return library.find("class")


def test_rqt_finds_the_plugin():
    found = described()
    assert found.get("base_class_type") == "rqt_gui_py::Plugin"
    assert found.findtext("qtgui/label") == "Leap Rig: control"


def test_the_package_does_not_need_rqt():
    depends = ElementTree.parse(PACKAGE / "package.xml").getroot()
    names = {element.text for element in depends if "depend" in element.tag}
    assert not any("rqt" in name or name == "qt_gui" for name in names)


def test_the_plugin_adds_the_panel_and_disconnects_it(virtual_graph, plugin_class):
    publisher = rospy.Publisher("kuka/status", KukaStatus, queue_size=1, latch=True)
    publisher.publish(KukaStatus(host="far-away", mode="home", reason="The arm is at home."))
    context = Context(1)
    plugin = plugin_class(context)
    (panel,) = context.widgets
    assert panel.windowTitle() == "Leap Rig: control" and plugin.objectName()
    clock.sleep(0.1)
    plugin._link._refresh()
    assert panel.control.isEnabled() and publisher.get_num_connections() == 1
    plugin.shutdown_plugin()
    clock.sleep(0.1)
    assert publisher.get_num_connections() == 0


def test_several_panels_have_titles_of_their_own(virtual_graph, plugin_class):
    first, second = Context(1), Context(2)
    plugins = [plugin_class(first), plugin_class(second)]
    assert first.widgets[0].windowTitle() != second.widgets[0].windowTitle()
    for plugin in plugins:
        plugin.shutdown_plugin()
