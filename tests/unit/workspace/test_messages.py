"""Message files of upstream_msgs: their MD5 sums are those of upstream, without a build."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from genmsg import MsgContext, gentools, msg_loader

ROOT = Path(__file__).parents[3]
UPSTREAM = ROOT / "src" / "upstream_msgs"
PACKAGES = ("control_msgs", "controller_manager_msgs", "gazebo_msgs", "gazebo_ros_link_attacher")
GENACTION = "/usr/lib/actionlib_msgs/genaction.py"  # what catkin_make turns .action files with


def expected() -> dict[str, str]:
    lines = (ROOT / "tests" / "upstream_md5.txt").read_text().splitlines()
    return dict(line.split() for line in lines if not line.startswith("#"))


@pytest.fixture(scope="module")
def search_path(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """Package → folders of .msg files; those of the actions are generated into one of ours."""
    actions = tmp_path_factory.mktemp("actions")
    for action in sorted(UPSTREAM.glob("control_msgs/action/*.action")):
        subprocess.run(["/usr/bin/python3", GENACTION, action, "-o", actions], check=True)
    folders = {p.parent.name: [str(p)] for p in Path("/usr/share").glob("*_msgs/msg")}
    folders |= {package: [str(UPSTREAM / package / "msg")] for package in PACKAGES}
    folders["control_msgs"].append(str(actions))
    return folders


def md5(name: str, search_path: dict[str, list[str]]) -> str:
    package, short = name.split("/")
    context = MsgContext.create_default()
    service = UPSTREAM / package / "srv" / f"{short}.srv"
    if service.exists():
        spec = msg_loader.load_srv_from_file(context, str(service), name)
    else:
        spec = msg_loader.load_msg_by_type(context, name, search_path)
    msg_loader.load_depends(context, spec, search_path)
    return gentools.compute_md5(context, spec)


@pytest.mark.parametrize("name", expected())
def test_type_has_upstreams_md5(name: str, search_path: dict[str, list[str]]) -> None:
    assert md5(name, search_path) == expected()[name]


def test_no_type_goes_unchecked(search_path: dict[str, list[str]]) -> None:
    files = {
        f"{package}/{file.stem}"
        for package in PACKAGES
        for folder in (*search_path[package], UPSTREAM / package / "srv")
        for file in Path(folder).glob("*.[ms][sr][gv]")
    }
    assert files == set(expected())


def test_every_file_is_built() -> None:
    # a definition that its CMakeLists.txt forgets would be found here and be missing at run time
    for package in PACKAGES:
        listed = (UPSTREAM / package / "CMakeLists.txt").read_text().split()
        definitions = UPSTREAM.glob(f"{package}/*/*.*")
        assert {file.name for file in definitions} <= set(listed), package
