"""Where a node's log goes: rospy ends with a traceback where that folder cannot be written."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import rospkg
import rospy


def check_log_folder(name: str) -> None:
    """Have rospy write the log of this node elsewhere where it could not write it; one line tells.

    Call it before rospy.init_node. The folder is that of the remapping __log, which roslaunch
    gives each node, or else ROS_LOG_DIR, or log in ROS_HOME.
    """
    mappings = rospy.names.get_mappings()
    given = mappings.get("__log")
    folder = Path(given).absolute().parent if given else Path(rospkg.get_log_dir())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError as error:
        mappings.pop("__log", None)
        os.environ["ROS_LOG_DIR"] = other = tempfile.mkdtemp(prefix="ros_log_")
        text = f"its log cannot be written to {folder} ({error.strerror}) and goes to {other}"
        print(f"{name}: {text}: set ROS_LOG_DIR to a folder that can be written", file=sys.stderr)
