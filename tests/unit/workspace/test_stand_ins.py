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


HARDWARE = "#include <hardware_interface/robot_hw.h>\n"


@pytest.mark.parametrize(("source", "header", "left_out"), [
    (f'{HARDWARE}# include "controller_interface/a.h"\n', "", ["arm_hw"]),
    # a header of the package counts for all its targets
    ("int a;\n", "#include <joint_limits_interface/joint_limits.h>\n", ["arm_hw", "talker"]),
    (f"// {HARDWARE}#include <cmath>\n", "", []),
])  # fmt: skip
def test_a_target_that_needs_their_headers_is_one_line_and_the_rest_is_built(
    built, tmp_path, source, header, left_out
):  # fmt: skip
    lines = built(source, header).splitlines()
    assert sorted(line.split(" is ")[0] for line in lines) == [f"arm: {one}" for one in left_out]
    if left_out == ["arm_hw"]:
        assert lines[0].startswith(
            "arm: arm_hw is not built: it includes C++ headers of hardware_interface, "
            "controller_interface, which aras_sim_bridge does not contain; ")
    assert (tmp_path / "build/talker").exists() == ("talker" not in left_out)
    assert bool(list((tmp_path / "build").glob("*.so"))) == ("arm_hw" not in left_out)


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
