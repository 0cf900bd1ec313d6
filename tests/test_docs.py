"""Generated pages match the source, links have targets, commands exist."""

from __future__ import annotations

import ast
import functools
import re
import xml.etree.ElementTree as ElementTree

import pytest

from tools.handbook import commands, pages
from tools.reference import nodes, parameters, sources
from tools.reference.pages import PAGES
from tools.reference.syntax import dotted

WORDS = 30_000
"""At most so many words in all hand-written pages together."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.ros] * (name == "parameters.md")) for name in PAGES]
)
def test_generated_page_is_as_the_source(name):
    if name == "messages.md":
        pytest.importorskip("genmsg")
    assert (sources.REFERENCE / name).read_text() == PAGES[name](), "run make docs"


def test_every_yaml_is_a_table_or_shown_as_it_is():
    files = {sources.inside(file) for file in sources.ROOT.glob("src/**/config/**/*.yaml")}
    assert files == parameters.SCHEMAS.keys() | parameters.AS_IT_IS
    assert not parameters.SCHEMAS.keys() & parameters.AS_IT_IS


class TestPrivateParameters:
    """Nodes read them through common.ros.params, with schemas that the page shows; launch files set no others."""

    SOURCES = tuple(file for file in sources.ROOT.glob("src/**/src/*/ros/*.py") if file.name != "params.py")

    def test_are_read_in_one_way(self):
        others = [sources.inside(f) for f in self.SOURCES if re.search(r"_param\(\s*f?[\"']~", f.read_text())]
        assert not others, "use common.ros.params.private_config"

    @pytest.mark.parametrize(
        ("code", "schemas"),
        [
            ("config = private_config(DriverConfig)", {"DriverConfig"}),
            ("SECTIONS = {'a': AConfig}\nb = {n: private_config(s, n) for n, s in SECTIONS.items()}", {"AConfig"}),
            ("Driver(wait_for_config(Settings, rospy.get_name()))", {"Settings"}),
            ("config = wait_for_config(ArmConfig, 'kuka')", set()),
        ],
    )
    def test_schemas_are_found_in(self, code, schemas):
        assert private_schemas(code) == schemas

    def test_each_schema_is_on_the_page(self):
        shown = {schema for node in nodes.NODES.values() for schema in node.schemas.values()}
        shown |= {part.schema for parts in parameters.SCHEMAS.values() for part in parts}
        names = {schema.split(":")[1] for schema in shown}
        missing = {sources.inside(f): private_schemas(f.read_text()) - names for f in self.SOURCES}
        assert not {file: names for file, names in missing.items() if names}, "write them into tools/reference/nodes.py"

    @pytest.mark.ros
    def test_launch_files_set_those_of_the_page(self):
        sources.on_path()
        programs = {f"{sources.package(f)}/{f.name}": f for f in sources.ROOT.glob("src/**/scripts/*.py")}
        assert not nodes.NODES.keys() - programs.keys()
        wrong = []
        for launch in sources.ROOT.glob("src/**/launch/*.launch"):
            for node in ElementTree.parse(launch).getroot().iter("node"):
                program = f"{node.get('pkg')}/{node.get('type')}"
                given = {param.get("name") for param in node.findall("param")}
                if program in programs and given:
                    known = nodes.keys(program) if program in nodes.NODES else set()
                    wrong += [f"{launch.name}: {program}: {name}" for name in given - known]
        # What users of the published package have in their own launch files, and nothing depends on.
        assert [w for w in wrong if not w.endswith(": queue_size")] == []


def private_schemas(code: str) -> set[str]:
    """Returns the names of the schemas by which a module reads private parameters."""
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Call) and dotted(node.func) == "private_config":
            found.add(dotted(node.args[0]))
        if isinstance(node, ast.Call) and dotted(node.func) == "wait_for_config":
            name = node.args[1]
            if isinstance(name, ast.Call) and dotted(name.func).endswith("get_name"):
                found.add(dotted(node.args[0]))
        if isinstance(node, ast.Assign) and dotted(node.targets[0]) == "SECTIONS" and isinstance(node.value, ast.Dict):
            found |= {dotted(schema) for schema in node.value.values}
    return {name for name in found if name[:1].isupper()}


def test_every_picture_says_where_it_comes_from():
    folder = pages.ROOT / "docs" / "pictures"
    said = (folder / "README.md").read_text()
    assert not [file.name for file in folder.iterdir() if f"`{file.name}`" not in said and file.suffix != ".md"]


class TestPages:
    """All pages in one test for each rule: it names every page that breaks it."""

    PAGES = tuple(pages.pages())
    BLOCKS = tuple(block for page in PAGES for block in pages.blocks(page))

    def test_links_lead_somewhere(self):
        assert len(self.PAGES) > 50
        wrong = []
        for page in self.PAGES:
            for link in pages.links(page.read_text()):
                if "://" in link or link.startswith("mailto:"):
                    continue
                path, _, anchor = link.partition("#")
                target = (page.parent / path).resolve() if path else page
                known = target.exists() and pages.ROOT in target.parents
                if not known or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
                    wrong.append(f"{page}: {link} leads nowhere, or out of the project")
        assert not wrong

    def test_commands_exist(self):
        code = ((page, block) for page in self.PAGES for block in pages.code(page))
        wrong = [f"{page}, line {b.line}: {fault}" for page, b in code for fault in commands.faults(b.text)]
        assert not wrong

    def test_blocks_say_how_they_are_run(self):
        def known(mark, block):
            return pages.runs(mark, block) if mark.startswith(pages.ELSEWHERE) else mark in pages.MARKS

        assert not [f"{b.where}: {mark!r}" for b in self.BLOCKS for mark in b.marks if not known(mark, b)]

    def test_what_may_move_a_real_arm_says_so(self):
        unmarked = [block for block in self.BLOCKS if pages.REAL_HARDWARE not in block.marks]
        assert not [block.where for block in unmarked if commands.for_a_real_rig(block.text)]

    def test_hand_written_pages_stay_short(self):
        """A page that one reads is short. The limit only ever goes down."""
        count = {
            str(p.relative_to(pages.ROOT)): pages.words(p.read_text()) for p in self.PAGES if not pages.generated(p)
        }
        total = sum(count.values())
        assert total <= WORDS, f"{total} words; longest: {sorted(count.items(), key=lambda item: -item[1])[:5]}"


@functools.lru_cache(maxsize=None)
def anchors(page) -> set[str]:
    return pages.anchors(page.read_text())


class TestChecker:
    def test_words_are_what_a_reader_reads(self):
        assert pages.words("# A [link](x y.md), 2 | `c`\n<!-- no -->\n```bash\nnone\n```\nend — .\n") == 5

    @pytest.mark.parametrize(
        ("command", "faults"),
        [
            ("make tea", 1),
            ("make demo HEADLES=1", 1),
            ("make demo HEADLESS=1 ARGS='viewer:=true'", 0),
            ("rosrun kuka_control nothing.py", 1),
            ("rosrun kuka_control workspace_plotter.py --paint", 1),
            ("rosrun kuka_control workspace_plotter.py --save workspace.png", 0),
            ("rosrun tf2_tools view_frames.py", 0),
            ("rosrun tf2_tools echo.py kuka/base_frame kuka/tool_frame/measured", 0),
            ("rosrun PACKAGE PROGRAM", 0),
            ("roslaunch leap_rig nothing", 1),
            ("cd x && roslaunch leap_rig demo simm:=false", 1),
            ("sudo roslaunch leap_rig demo sim:=false", 0),
            ("rosservice call kuka/kuka_controll true", 1),
            ("rosservice call kuka/kuka_control true  # on", 0),
            ("rostopic hz /kuka/joint_position", 1),
        ],
    )
    def test_sees_what_is_not_there_and_nothing_else(self, command, faults):
        assert len(commands.faults(command)) == faults

    def test_anchors_are_those_of_the_repository_page(self):
        text = "# A title, `code` and [link](x.md)\n## tags.yaml\n## Twice\n## Twice\n```\n# none\n```\n"
        assert pages.anchors(text) == {"a-title-code-and-link", "tagsyaml", "twice", "twice-1"}

    @pytest.mark.parametrize(
        ("command", "real"),
        [
            ("roslaunch leap_rig demo", False),
            ("roslaunch leap_rig demo sim:=false marker_ring:=true", True),
            ("roslaunch leap_rig demo sim:=false robot_ip:=172.31.1.147", True),
            ("roslaunch leap_rig demo sim:=false robot_ip:=127.0.0.1 hand_interface:=lo", False),
            ("roslaunch vision camera.launch sim:=false", True),
            ("roslaunch vision camera_apriltag.launch", True),
            ("roslaunch leap_rig leap_rig.launch registration:=desk", True),
            ("roslaunch leap_rig leap_rig.launch sim:=true auto_start:=true", False),
            ("roslaunch kuka_control real_time_controller.launch", True),
            ("roslaunch kuka_control real_time_controller.launch ip:=127.0.0.1", False),
            ("roslaunch kuka_control ptp_controller.launch ip:=172.31.1.147", True),
            ("roslaunch kuka_control ptp_controller.launch sim:=true", False),
            ("roslaunch vision plane_pose.launch camera:=false", False),
            ("rosrun kuka_control simple_controller.py zero", True),
            ("rosrun kuka_control simple_controller.py --ip 172.31.1.147 zero", True),
            ("rosrun kuka_control simple_controller.py --list", False),
            ("rosrun kuka_control simple_controller.py --ip 127.0.0.1 zero", False),
            ("rosrun vision calibrate_camera.py", True),
            ("rosrun vision calibrate_camera.py --ip 127.0.0.1", False),
        ],
    )
    def test_sees_what_may_move_a_real_arm(self, command, real):
        assert commands.for_a_real_rig(command) == [command] * real

    def test_blocks_of_a_page(self, tmp_path):
        page = tmp_path / "page.md"
        page.write_text(
            "# Page\n<!-- slow -->\n```bash\nmake bench  # long\n\n# remark\n```\n\n```python\n# no heading\n```\n"
            "```text\nx\n```\n## Next\n<!-- running rig, until Ctrl-C -->\n\n  ```bash\n  make \\\n    help\n  ```\n"
        )
        assert [(b.marks, b.commands, b.line, b.language, b.section) for b in pages.blocks(page)] == [
            (("slow",), ["make bench"], 4, "bash", 1),
            ((), [], 10, "python", 1),
            (("running rig", "until Ctrl-C"), ["make    help"], 19, "bash", 2),
        ]

    @pytest.mark.parametrize(
        ("mark", "found"),
        [
            ("run by tools/test.sh", True),
            ("run by tools/no.sh", False),
            ("run by tests/test_docs.py::TestChecker", True),
            ("run by tests/test_docs.py::test_no", False),
            ("run by docs/handbook/workspace.md", True),
            ("run by docs/handbook/training.md", False),
        ],
    )
    def test_what_runs_a_block_elsewhere(self, mark, found):
        block = pages.Block(
            pages.ROOT / "README.md", 1, "rosrun kuka_control workspace_plotter.py --save workspace.png"
        )
        assert pages.runs(mark, block) is found
