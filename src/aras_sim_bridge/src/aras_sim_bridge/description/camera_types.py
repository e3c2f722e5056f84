"""Dataclasses of a camera in a robot description; lengths are in m, angles in rad."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from aras_visual_servo_base.poses import Vector3
from aras_visual_servo_base.settings import parameter


@dataclass(frozen=True)
class PixelNoise:
    """Noise of each pixel of a camera; 1.0 is the full scale of a pixel (255)."""

    kind: str = "none"
    mean: float = 0.0
    stddev: float = 0.0


@dataclass(frozen=True)
class LensDescription:
    """`<lens>` of a camera.

    Attributes:
        kind, scale_to_hfov, cutoff_angle: projection of a camera of the kind `wideanglecamera`; the
            angle is in rad.
        intrinsics: (fx, fy, cx, cy) of a pinhole camera, px, or None. The principal point is
            measured from the corner of the image.
    """

    kind: str = "gnomonical"
    scale_to_hfov: bool = True
    cutoff_angle: float = 1.5707963267948966
    intrinsics: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class DepthDescription:
    """Depth output of a depth camera.

    Attributes:
        image, info, points: topics below the camera's name; `points` is '' if there are no point
            clouds.
        nearest, farthest: range of depths, m; other depths are NaN, or 0 in millimetre images.
        millimetres: whether depth images are 16UC1 instead of 32FC1.
        rows: whether a point cloud has the image's rows; otherwise it has a single row.
    """

    image: str = "depth/image_raw"
    info: str = "depth/camera_info"
    points: str = ""
    nearest: float = parameter(0.0, "m", least=0.0)
    farthest: float = parameter(math.inf, "m", above=0.0, infinite=True)
    millimetres: bool = False
    rows: bool = True


@dataclass(frozen=True)
class CameraPlugin:
    """Camera plug-in with the default values of `libgazebo_ros_camera.so`.

    Attributes:
        distortion: coefficients (k1, k2, k3, t1, t2).
        trigger_topic: topic whose messages trigger an exposure; '' if the camera publishes
            continuously.
        depth: depth output of a depth camera.
    """

    robot_namespace: str = ""
    camera_name: str = ""
    image_topic: str = "image_raw"
    info_topic: str = "camera_info"
    frame_name: str = ""
    update_rate: float = 0.0
    hack_baseline: float = 0.0
    cx: float = 0.0
    cy: float = 0.0
    focal_length: float = 0.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    auto_distortion: bool = False
    trigger_topic: str = ""
    depth: DepthDescription | None = None


@dataclass(frozen=True)
class CameraDescription:
    """A camera sensor on a link.

    Attributes:
        pose: (xyz, rpy) in the link; the camera looks along its +x axis, with z up.
        kind: camera, depth or wideanglecamera.
        distortion: coefficients (k1, k2, k3, p1, p2) in the `<sensor>`, or None if it has no
            `<distortion>`.
        distortion_center: centre of the distortion, in fractions of the image size.
        shutter: name of the group of cameras of the same model that expose simultaneously; '' if
            the camera is not synchronised.
    """

    name: str
    link: str
    pose: tuple[Vector3, Vector3]
    kind: str
    update_rate: float
    horizontal_fov: float
    width: int
    height: int
    format: str
    near: float
    far: float
    noise: PixelNoise = field(default_factory=PixelNoise)
    distortion: tuple[float, float, float, float, float] | None = None
    distortion_center: tuple[float, float] = (0.5, 0.5)
    lens: LensDescription | None = None
    plugin: CameraPlugin | None = None
    shutter: str = ""
