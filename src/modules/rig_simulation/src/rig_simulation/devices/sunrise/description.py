"""The robot description: in the package rig_description as ROS knows it or, without ROS, in the source tree."""

from __future__ import annotations

from pathlib import Path

ROBOTS = ("LBR7R800", "LBR14R820")
FLANGES = ("MF_elektrisch", "MF_pneumatisch", "MF_IO_pneumatisch", "MF_touch_pneumatisch")
PACKAGE = "rig_description"
SOURCE_TREE = Path(__file__).resolve().parents[5] / PACKAGE


def read_urdf(robot: str, flange: str, ring: bool = False) -> str:
    """Returns the URDF of an arm with a media flange; `ring`: with the ring of the marker board.

    Raises:
        FileNotFoundError: no such description is installed.
    """
    name = f"{'with_ring/' if ring else ''}{robot.lower()}_{flange}.urdf"
    for folder in package_folders(PACKAGE, SOURCE_TREE):
        path = folder / "urdf" / name
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise FileNotFoundError(f"There is no urdf/{name} in the package {PACKAGE}; check the robot and the flange.")


def package_folders(package: str, source_tree: Path) -> list[Path]:
    """Returns the folders of a package: in the source tree and, with ROS, where ROS knows it."""
    try:
        import rospkg

        return [source_tree, Path(rospkg.RosPack().get_path(package))]
    except Exception:  # without ROS, or without that package in it, rospkg fails in several ways
        return [source_tree]
