"""camera_apriltag.launch: what it starts and with which board, and that the boards are those of the simulated world."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from apriltag_ros.settings import targets

CONFIG = Path(__file__).parents[1] / "config"


@pytest.mark.parametrize(("board", "tags"), [("bundle", "tags.yaml"), ("single", "tags_single.yaml")])
def test_the_simulated_board_has_the_same_tags(board, tags):
    from rig_simulation.files import read_board

    (target,) = targets(yaml.safe_load((CONFIG / tags).read_text()))
    simulated = {tag["id"]: (tag["size"], *tag["position"]) for tag in read_board(board)["tags"]}
    assert target.name == yaml.safe_load((CONFIG / "panel.yaml").read_text())["frame"]
    assert {tag.id: (tag.size, *tag.T_target_tag[:2, 3]) for tag in target.tags} == simulated


@pytest.mark.parametrize(("simulated", "file"), [("bundle", "panel.yaml"), ("single", "panel_single.yaml")])
def test_the_simulated_board_sits_where_the_drawing_says(simulated, file):
    from common.config import parse
    from common.poses import pose
    from rig_simulation.files import read_board
    from rig_simulation.world.model import R_FLANGE_BOARD
    from vision.marker_board.board import MarkerBoardConfig

    board = parse(MarkerBoardConfig, yaml.safe_load((CONFIG / file).read_text()))
    plate = read_board(simulated)
    np.testing.assert_allclose(board.T_flange_tag, pose(R_FLANGE_BOARD, plate["centre"]), atol=1e-12)
    assert plate["size"] == [board.plate, board.plate]


@pytest.mark.ros
@pytest.mark.parametrize(("board", "plate", "bundles"), [("bundle", 0.3, 1), ("single", 0.125, 0)])
def test_parameters(board, plate, bundles):
    from tools import launched

    values = launched.parameters("vision", "camera_apriltag.launch", f"panel:={board}", "serial:=0712")
    assert "/kuka/mounting" not in values, "a controller may have set it"
    assert values["/camera_calibration/panel/plate"] == plate
    assert values["/camera_calibration/store/camera"] == "0712"
    assert len(values["/apriltag_ros_continuous_node/tag_bundles"]) == bundles
    assert values["/apriltag_ros_continuous_node/rectified"] is False


@pytest.mark.ros
def test_mounting():
    from tools import launched

    values = launched.parameters("vision", "camera_apriltag.launch", "mounting:=180 0 0")
    assert values["/kuka/mounting"] == [180, 0, 0]


@pytest.mark.ros
def test_nodes():
    from tools import launched

    def nodes(*args):
        return launched.nodes("vision", "camera_apriltag.launch", *args)

    assert nodes("camera:=false") == {"/apriltag_ros_continuous_node", "/camera_place"}
    assert {"/camera/driver", "/camera/frames"} <= nodes()
    assert {"/rviz", "/robot_state_publisher"} <= nodes("rviz:=true")
