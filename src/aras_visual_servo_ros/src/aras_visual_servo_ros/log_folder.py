"""Selection of a writable log folder, because rospy fails if its log folder is read-only."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import rospkg
import rospy


def check_log_folder(name: str) -> None:
    """Use a temporary log folder if the log folder of this node is not writable.

    The change is reported in one line. Call this before rospy.init_node. roslaunch sets the log
    folder of each node by the remapping __log. Without this remapping, the log folder is
    ROS_LOG_DIR, or else the folder `log` in ROS_HOME.
    """
    mappings = rospy.names.get_mappings()
    log_file = mappings.get("__log")
    folder = Path(log_file).absolute().parent if log_file else Path(rospkg.get_log_dir())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError as error:
        mappings.pop("__log", None)
        os.environ["ROS_LOG_DIR"] = fallback = tempfile.mkdtemp(prefix="ros_log_")
        text = f"cannot write the log to {folder} ({error.strerror}), so it is in {fallback}"
        print(f"{name}: {text}: set ROS_LOG_DIR to a writable folder", file=sys.stderr)
