"""Packages are found where ROS finds them, also if they are added or removed at run time."""

import os

import pytest
import rospkg

from aras_sim_bridge.description import packages
from aras_sim_bridge.errors import DescriptionError, UnsupportedPartError


def make(folder, name):
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")


def test_packages_may_be_made_and_moved_and_what_was_found_is_not_searched_again(
        tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    with pytest.raises(DescriptionError, match="package 'late_arm' is not in ROS_PACKAGE_PATH"):
        packages.find_package("late_arm")
    make(tmp_path / "src" / "arm", "late_arm")
    assert packages.find_package("late_arm") == str(tmp_path / "src" / "arm")
    make(tmp_path / "a", "late_arm")  # which a search would find first
    assert packages.find_package("late_arm") == str(tmp_path / "src" / "arm")
    os.rename(tmp_path / "src", tmp_path / "0")
    assert packages.find_package("late_arm") == str(tmp_path / "a")


def test_packages_are_found_where_rospack_finds_them(tmp_path, monkeypatch):
    """The first of two of one name; one with an old manifest is named after its folder."""
    first, second = tmp_path / "first", tmp_path / "second"
    names = {first / "whole": "whole", first / "whole/inner": "inner", first / "a/b": "deep",
             first / "ignored/c": "ignored", first / "closed/d": "closed", first / ".git/e": "git",
             first / "twice": "twice", second / "again": "twice", second / "f": "other"}
    for folder, name in names.items():
        make(folder, name)
    for name in ("ignored/CATKIN_IGNORE", "closed/rospack_nosubdirs"):
        (first / name).touch()
    (second / "old").mkdir()
    (second / "old/manifest.xml").write_text("<package/>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{first}:/nowhere::{second}")
    monkeypatch.setenv("CMAKE_PREFIX_PATH", "")
    rospack = rospkg.RosPack([str(first), str(second)])
    found = []
    for name in sorted({*names.values(), "old", "f", "again"}):
        try:
            expected = rospack.get_path(name)
        except rospkg.ResourceNotFound:
            with pytest.raises(
                UnsupportedPartError, match=f"package '{name}' is not in ROS_PACKAGE_P"
            ):
                packages.find_package(name)
        else:
            assert packages.find_package(name) == expected
            found.append(name)
    assert found == ["deep", "old", "other", "twice", "whole"]


def test_which_folders_are_searched_and_what_a_manifest_may_be(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    make(tmp_path / "1/2/3/4/5", "deep")
    make(tmp_path / "1/2/3/4/six/6", "deeper")
    for name in ("CMakeFiles", "__pycache__", "node_modules"):
        make(tmp_path / name / "p", f"in{name}")
        with pytest.raises(UnsupportedPartError):
            packages.find_package(f"in{name}")
    assert packages.find_package("deep") == str(tmp_path / "1/2/3/4/5")
    with pytest.raises(UnsupportedPartError):
        packages.find_package("deeper")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "1"))
    assert packages.find_package("deeper") == str(tmp_path / "1/2/3/4/six/6")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    for name, text in (("bytes", b"\xff\xfe"), ("nameless", b"<package/>"),
                       ("folder", b"<package>\n<name>\n  declared </name></package>")):
        make(tmp_path / name, "x")
        (tmp_path / name / "package.xml").write_bytes(text)
    assert packages.find_package("bytes") == str(tmp_path / "bytes")
    assert packages.find_package("nameless") == str(tmp_path / "nameless")
    assert packages.find_package("declared") == str(tmp_path / "folder")
    with pytest.raises(UnsupportedPartError):
        packages.find_package("folder")


def test_installed_packages_are_below_share(tmp_path, monkeypatch):
    """What is built has precedence, then one prefix after the other; /usr comes last."""
    built, one, two = (tmp_path / name for name in ("built", "one", "two"))
    make(built / "arm", "arm")
    for prefix, names in ((one, ("arm", "hand")), (two, ("hand", "eye"))):
        for name in names:
            make(prefix / "share" / name, name)
    (one / "share/eye").mkdir()  # no package
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(built))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", f"{one}::{two}")
    assert packages.find_package("arm") == str(built / "arm")
    assert packages.find_package("hand") == str(one / "share/hand")
    assert packages.find_package("eye") == str(two / "share/eye")
    assert packages.find_package("catkin") == "/usr/share/catkin"


@pytest.mark.parametrize("name", ["", "1st", "_arm", "-arm", "an arm", "arm/hand", "arm\n", "är"])
def test_a_name_that_no_package_has_is_refused(name):
    with pytest.raises(DescriptionError, match="is not a package name: use letters, digits"):
        packages.find_package(name)


@pytest.mark.parametrize(("uri", "path"), [
    ("package://arm/meshes/a.stl", "/pack/arm/meshes/a.stl"),
    ("package://arm//meshes/./b/../a.stl", "/pack/arm/meshes/a.stl"),
    ("package://arm", "/pack/arm"), (" package://arm/a.stl\n", "/pack/arm/a.stl"),
    ("model://arm/a.stl", "/pack/arm/a.stl"), ("file:///b/a.stl", "/b/a.stl"),
    ("file://b//a.stl", "/b/a.stl"), ("/b/./c/../a.stl", "/b/a.stl"),
    ("meshes/a.stl", "/base/meshes/a.stl"), ("../a.stl", "/a.stl")])
def test_the_path_that_a_uri_names(monkeypatch, uri, path):
    monkeypatch.setenv("GAZEBO_MODEL_PATH", "")
    monkeypatch.setenv("HOME", "/nowhere")
    assert packages.locate(uri, "here", "/pack/{}".format, "/base") == path


@pytest.mark.parametrize(("uri", "reason"), [
    (" \n", "here: the mesh file name is empty or contains a NUL character"),
    ("/a\0b", "here: the mesh file name is empty or contains a NUL character"),
    ("a.stl", "here: mesh 'a.stl' is a relative path, but the description was not"),
    ("package://arm/../b/a", "here: mesh 'package://arm/../b/a' is outside of package 'arm'"),
    ("package://arm/../armour/a.stl", "outside of package 'arm'; keep the file inside"),
    ("ftp://arm/a.stl", "here: mesh 'ftp://arm/a.stl' has the unknown scheme 'ftp://'"),
    ("ftp://" + 194 * "a", f"mesh 'ftp://{194 * 'a'}' has"),
    ("ftp://" + 195 * "a", f"mesh 'ftp://{194 * 'a'}…' has")])
def test_a_uri_that_names_no_path_is_refused(monkeypatch, uri, reason):
    with pytest.raises(UnsupportedPartError) as refused:
        packages.locate(uri, "here", "/pack/{}".format)
    assert reason in str(refused.value)
    with pytest.raises(DescriptionError, match="here: the material file name is empty"):
        packages.locate("", "here", what="material")
    monkeypatch.setenv("ROS_PACKAGE_PATH", "")
    for name in ("no_such_arm", "no arm"):
        with pytest.raises(UnsupportedPartError, match=f"here: mesh 'package://{name}/a': "):
            packages.locate(f"package://{name}/a", "here")
