"""A run's report with a video of its images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ...errors import StudyError, catch_write_errors
from ...recording.run import Run
from .write import write_report


def write_with_video(run: Run, out: Path) -> list[Path]:
    """Write a report, with video.mp4 where the run has images; StudyError where it cannot."""
    with catch_write_errors(f"into {out}"):
        written = write_report([run], out, ("png",))
        if run.control_record.images:
            written.append(write_video(run, out / "video.mp4"))
    return written


def write_video(run: Run, path: Path) -> Path:
    """Write the images of a run as a video; StudyError where it cannot."""
    stamp, pictures = run.stamp, [picture for _, picture in run.control_record.images]
    rate = 1.0 / float(np.median(np.diff(stamp))) if len(stamp) > 1 else 30.0
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not writer.isOpened():
        raise StudyError(f"cannot write the video {path}")
    for picture in pictures:
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
    writer.release()
    return path
