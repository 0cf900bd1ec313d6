"""Whether the nodelets can be loaded is known before they are, and said in a sentence."""

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospkg

from vision.ros.camera.register_node import missing_packages

pytestmark = pytest.mark.ros
DEBIAN = {
    "image_proc": "libimage-proc-dev",
    "depth_image_proc": "libdepth-image-proc-dev",
    "nodelet": "libnodeletlib-tools",
}


@pytest.fixture
def install(tmp_path):
    def made(name, described=True):
        (tmp_path / name).mkdir()
        export = '<export><nodelet plugin="${prefix}/nodelet_plugins.xml"/></export>' if name != "nodelet" else ""
        (tmp_path / name / "package.xml").write_text(f"<package><name>{name}</name>{export}</package>")
        if described:
            (tmp_path / name / "nodelet_plugins.xml").write_text("<library/>")

    return made


def missing(*folders):
    return missing_packages(rospkg.RosPack([str(folder) for folder in folders] or None))


@pytest.mark.parametrize("without", ["", *DEBIAN])
def test_what_is_missing_is_named(install, tmp_path, without):
    for name in DEBIAN:
        if name != without:
            install(name)
    assert missing(tmp_path) == ([DEBIAN[without]] if without else [])


def test_a_package_without_the_description_of_its_nodelets_is_half_a_package(install, tmp_path):
    for name in DEBIAN:
        install(name, described=name != "image_proc")
    assert missing(tmp_path) == ["libimage-proc-dev"]


def test_nodelets_that_are_not_there_end_with_a_sentence(ros):
    names = missing()
    if not names:
        pytest.skip("they are there")
    node = ros.run("vision", "register_rgbd_start.py", "--nodelets", "true")
    assert node.wait(1.0) == 1
    log = node.log_path.read_text()
    assert ", ".join(names) in log and "nodelets:=false" in log
    assert "Traceback" not in log


def test_by_itself_it_takes_our_own_node_then(ros, monkeypatch):
    if not missing():
        pytest.skip("the nodelets are there")
    monkeypatch.setattr("os.execvp", lambda *words: pytest.fail(f"it starts {words}"))
    node = ros.run("vision", "register_rgbd_start.py", "__ns:=camera", "__name:=register_rgbd")
    clock.sleep(0.5)
    assert "/camera/depth_registered/points" in ros.names("/camera/register_rgbd")["publishes"]
    assert node.poll() is None
