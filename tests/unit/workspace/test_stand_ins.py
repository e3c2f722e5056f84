"""Placeholder packages: only C++ targets that need their headers are reported."""

import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

NAMES = Path(__file__).parents[3] / "src" / "upstream_names"
REPORT = NAMES / "aras_stand_in" / "cmake" / "report_stand_ins.cmake"
PROJECT = f"""cmake_minimum_required(VERSION 3.10)
project(arm CXX)
include({REPORT})
include({REPORT})
add_library(arm_hw SHARED src/hw.cpp)
add_executable(talker src/talker.cpp)
add_custom_target(arm_messages)
"""


@pytest.fixture
def built(tmp_path):
    """Factory: what CMake prints of a package with this in its library and in a header of its."""

    def run(source: str, header: str = "") -> str:
        for path, text in (("src/hw.cpp", source), ("src/talker.cpp", "int main() { return 0; }\n"),
                           ("include/arm/hw.h", header), ("CMakeLists.txt", PROJECT)):
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text)
        for command in (["-S", ".", "-B", "build"], ["--build", "build"]):
            done = subprocess.run(["/usr/bin/cmake", *command], cwd=tmp_path, text=True,
                                  timeout=300, capture_output=True)
            assert done.returncode == 0, done.stderr
            if command[0] == "-S":
                said = done.stderr
        return said

    return run


def test_a_target_that_needs_their_headers_is_one_line_and_the_rest_is_built(built, tmp_path):
    said = built('#include <hardware_interface/robot_hw.h>\n# include "controller_interface/a.h"\n')
    (line,) = said.splitlines()
    assert line.startswith(
        "arm: arm_hw is not built: it includes C++ headers of hardware_interface, "
        "controller_interface, which aras_sim_bridge does not contain; ")
    assert (tmp_path / "build/talker").exists()
    assert not list((tmp_path / "build").glob("*.so"))


def test_a_header_of_the_package_counts_for_all_its_targets(built, tmp_path):
    said = built("int a;\n", "#include <joint_limits_interface/joint_limits.h>\n")
    assert sorted(line.split(" is ")[0] for line in said.splitlines()) == [
        "arm: arm_hw", "arm: talker"]


def test_a_package_without_their_headers_is_built_and_nothing_is_said(built, tmp_path):
    assert built('// #include <hardware_interface/robot_hw.h>\n#include <cmath>\n') == ""
    assert list((tmp_path / "build").glob("*.so"))


def test_every_name_is_a_package_that_steps_aside_and_that_the_report_knows():
    packages = {manifest.parent for manifest in NAMES.glob("*/package.xml")}
    known = set(re.findall(r"[a-z_]+", re.search(r"set\(names\n(.*?)\n  \)", REPORT.read_text(),
                                                 re.DOTALL).group(1)))
    own = {"aras_stand_in", "xacro"}
    assert {package.name for package in packages} - own == known - {"gazebo"}
    for package in packages - {NAMES / "aras_stand_in"}:
        text = (package / "CMakeLists.txt").read_text()
        assert f"project({package.name})" in text and "step_aside(${PROJECT_NAME})" in text
        if package.name not in own:
            assert "catkin_package(CATKIN_DEPENDS aras_stand_in)" in text
            root = ElementTree.parse(package / "package.xml").getroot()
            assert root.findtext("name") == package.name
            assert "aras_stand_in" in [one.text for one in root.iter("depend")]
