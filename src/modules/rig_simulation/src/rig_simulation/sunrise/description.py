"""Where the robot description is: the package rig_description of the workspace or, without ROS, of the source tree."""

from __future__ import annotations

from pathlib import Path

ROBOTS = ("LBR7R800", "LBR14R820")
FLANGES = ("MF_elektrisch", "MF_pneumatisch", "MF_IO_pneumatisch", "MF_touch_pneumatisch")
PACKAGE = "rig_description"
SOURCE_TREE = Path(__file__).resolve().parents[4] / PACKAGE


def read_urdf(robot: str, flange: str) -> str:
    """Returns the text of the URDF of the arm `robot` with the media flange `flange`.

    Raises:
        FileNotFoundError: no such description is installed.
    """
    name = f"{robot.lower()}_{flange}.urdf"
    for folder in _folders():
        path = folder / "urdf" / name
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise FileNotFoundError(f"the package {PACKAGE} with urdf/{name} is not to be found")


def _folders() -> list[Path]:
    try:
        import rospkg

        return [SOURCE_TREE, Path(rospkg.RosPack().get_path(PACKAGE))]
    except Exception:  # without ROS, or without that package in it, rospkg fails in several ways
        return [SOURCE_TREE]
