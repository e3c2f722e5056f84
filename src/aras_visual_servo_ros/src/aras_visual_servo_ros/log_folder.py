"""Selection of a writable log folder, because rospy fails if its log folder is read-only."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import rospkg
import rospy


def check_log_folder(name: str) -> None:
    """Use a temporary log folder, and print this in one line, if the log folder is not writable.

    Call this before rospy.init_node. The log folder is given by the remapping __log, which
    roslaunch sets for each node. Without it, the log folder is ROS_LOG_DIR or else the folder `log`
    in ROS_HOME.
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
        text = f"its log cannot be written to {folder} ({error.strerror}), so it is in {fallback}"
        print(f"{name}: {text}: set ROS_LOG_DIR to a folder that can be written", file=sys.stderr)
