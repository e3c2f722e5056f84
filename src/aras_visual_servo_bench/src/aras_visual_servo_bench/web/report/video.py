"""Reports with a video of the images of a run."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ...errors import StudyError, catch_write_errors
from ...recording.run import Run
from .write import write_report


def write_with_video(run: Run, out: Path) -> list[Path]:
    """Write a report and, if the run has images, video.mp4; return the paths of all files.

    out: folder of the report.

    Raises:
        StudyError: a file cannot be written.
    """
    with catch_write_errors(f"into {out}"):
        written = write_report([run], out, ("png",))
        if run.control_record.images:
            written.append(write_video(run, out / "video.mp4"))
    return written


def write_video(run: Run, path: Path) -> Path:
    """Write the images of a run as a video, whose rate is the median image rate of the run.

    Raises:
        StudyError: the file cannot be written.
    """
    stamp, images = run.stamp, [image for _, image in run.control_record.images]
    rate = 1.0 / float(np.median(np.diff(stamp))) if len(stamp) > 1 else 30.0
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not writer.isOpened():
        raise StudyError(f"cannot write the video {path}: OpenCV cannot open the file")
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return path
