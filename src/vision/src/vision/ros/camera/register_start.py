"""Starts the registration of depth to colour: the nodelets of image_proc and depth_image_proc, or our own node.

Both have the same topics. The nodelets need their plugin descriptions, which Debian ships in development packages;
without a description the nodelet manager would only report that the class does not exist.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from xml.etree import ElementTree

import rospkg
import rospy

from vision.ros.camera import register_node

AUTO, NODELETS, OWN = "auto", "true", "false"
MANAGER = "nodelet"
"""The package with the nodelet manager, which has no nodelets itself."""

NEEDED = {
    "image_proc": "libimage-proc-dev",
    "depth_image_proc": "libdepth-image-proc-dev",
    MANAGER: "libnodeletlib-tools",
}
"""ROS packages, and the Debian packages that contain them completely."""


def main() -> None:
    """Replaces the process by the chosen program; exits with 1 if that is not installed."""
    parser = argparse.ArgumentParser(
        prog="register_rgbd_start.py",
        description="Starts the nodelets of depth_image_proc that register depth to colour, or our own node.",
    )
    parser.add_argument(
        "--nodelets",
        choices=(AUTO, NODELETS, OWN),
        default=AUTO,
        help="true: the nodelets; false: our own node; auto: the nodelets where they are installed (%(default)s)",
    )
    wanted = parser.parse_args(rospy.myargv()[1:]).nodelets
    missing = [] if wanted == OWN else missing_packages(rospkg.RosPack())
    if wanted == NODELETS and missing:
        print(
            f"register_rgbd: The nodelets need {', '.join(missing)}: install the packages, or use our own node with "
            "nodelets:=false.",
            file=sys.stderr,
        )
        sys.exit(1)
    if wanted == OWN or missing:
        register_node.main()
        return
    environment = {**os.environ, "ROS_NAMESPACE": "/"}
    os.execvpe("roslaunch", ["roslaunch", "vision", "register_nodelets.launch"], environment)


def missing_packages(packages: rospkg.RosPack) -> list[str]:
    """Returns the Debian packages that the nodelets lack; `packages` are those that ROS finds."""
    return [debian for package, debian in NEEDED.items() if not _is_complete(packages, package)]


def _is_complete(packages: rospkg.RosPack, package: str) -> bool:
    """Returns whether a package is installed with the descriptions of its nodelets."""
    try:
        folder = Path(packages.get_path(package))
        exports = ElementTree.parse(folder / "package.xml").findall("export/nodelet")
    except (rospkg.ResourceNotFound, OSError, ElementTree.ParseError):
        return False
    described = [Path(export.get("plugin", "").replace("${prefix}", str(folder))) for export in exports]
    return package == MANAGER or (bool(described) and all(file.is_file() for file in described))
