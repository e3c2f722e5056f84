"""Packages are found where ROS finds them, also those that come and go while we run."""

import os

import pytest

from aras_sim_bridge.description import packages
from aras_sim_bridge.errors import DescriptionError


def make(folder, name):
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")


def test_a_package_that_is_made_after_it_was_missed_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    with pytest.raises(DescriptionError, match="package 'late_arm' is not in ROS_PACKAGE_PATH"):
        packages.find("late_arm")
    make(tmp_path / "src" / "arm", "late_arm")
    assert packages.find("late_arm") == str(tmp_path / "src" / "arm")


def test_a_package_that_moved_is_found_in_its_new_place(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    make(tmp_path / "a", "moving_arm")
    assert packages.find("moving_arm") == str(tmp_path / "a")
    os.rename(tmp_path / "a", tmp_path / "b")
    assert packages.find("moving_arm") == str(tmp_path / "b")


def test_what_was_found_is_not_searched_again(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    make(tmp_path / "a", "kept_arm")
    packages.find("kept_arm")
    monkeypatch.setattr(packages, "_crawl", lambda *_: pytest.fail("searched again"))
    assert packages.find("kept_arm") == str(tmp_path / "a")
