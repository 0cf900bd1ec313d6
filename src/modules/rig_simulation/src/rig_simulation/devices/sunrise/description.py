"""Where the robot description is: the package rig_description of the workspace or, without ROS, of the source tree."""

from __future__ import annotations

from pathlib import Path

ROBOTS = ("LBR7R800", "LBR14R820")
FLANGES = ("MF_elektrisch", "MF_pneumatisch", "MF_IO_pneumatisch", "MF_touch_pneumatisch")
PACKAGE = "rig_description"
SOURCE_TREE = Path(__file__).resolve().parents[5] / PACKAGE


def read_urdf(robot: str, flange: str, ring: bool = False) -> str:
    """Returns the text of the URDF of the arm `robot` with the media flange `flange`; ring: that of the marker panel.

    Raises:
        FileNotFoundError: no such description is installed.
    """
    name = f"{'with_ring/' if ring else ''}{robot.lower()}_{flange}.urdf"
    for folder in package_folders(PACKAGE, SOURCE_TREE):
        path = folder / "urdf" / name
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise FileNotFoundError(f"the package {PACKAGE} with urdf/{name} is not to be found")


def package_folders(package: str, source_tree: Path) -> list[Path]:
    """Returns where a package's files may be: in its source tree and, with ROS, where ROS knows it."""
    try:
        import rospkg

        return [source_tree, Path(rospkg.RosPack().get_path(package))]
    except Exception:  # without ROS, or without that package in it, rospkg fails in several ways
        return [source_tree]
