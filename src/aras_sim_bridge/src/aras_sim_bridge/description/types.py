"""Dataclasses of a robot description, in SI units and radians, with rotations as rpy as in URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.settings import parameter
from aras_visual_servo_base.urdf import ZERO, FramedElement, Joint
from aras_visual_servo_base.urdf import Rgba as Rgba


@dataclass(frozen=True)
class Geometry:
    """A shape.

    Attributes:
        kind: box, cylinder, sphere, capsule, mesh or plane.
        size: side lengths of a box, m.
        radius, length: of a cylinder, sphere or capsule along z, m.
        filename: absolute path of a mesh file.
        scale: scale factors of a mesh.
        normal: normal of a plane.
    """

    kind: str
    size: Vector3 = ZERO
    radius: float = 0.0
    length: float = 0.0
    filename: str = ""
    scale: Vector3 = (1.0, 1.0, 1.0)
    normal: Vector3 = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Visual(FramedElement):
    """A visible shape of a link, whose colour is in `RobotDescription.colours`.

    Attributes:
        texture: path of the image from its material script, '' for none.
    """

    name: str
    origin_xyz: Vector3
    origin_rpy: Vector3
    geometry: Geometry
    texture: str = ""


@dataclass(frozen=True)
class Collision(FramedElement):
    """A shape for collision detection."""

    name: str
    origin_xyz: Vector3
    origin_rpy: Vector3
    geometry: Geometry


@dataclass(frozen=True)
class Inertial(FramedElement):
    """Mass (kg), centre of mass frame in the link frame, and inertia tensor (kg m²).

    Attributes:
        inertia: (ixx, ixy, ixz, iyy, iyz, izz) about the centre of mass, in the axes of the
            inertial frame.
    """

    mass: float
    origin_xyz: Vector3
    origin_rpy: Vector3
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Link:
    """A rigid body.

    Attributes:
        gravity, kinematic: from `<gazebo reference>` (`<gravity>`, `<turnGravityOff>`,
            `<kinematic>`).
        mu: Coulomb friction coefficient of contacts.
        bounce: coefficient of restitution, and the speed (m/s) below which contacts do not bounce;
            None if not given.
    """

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...] = ()
    collisions: tuple[Collision, ...] = ()
    gravity: bool = True
    kinematic: bool = False
    mu: float | None = None
    bounce: tuple[float, float] | None = None


@dataclass(frozen=True)
class Transmission:
    """One `<transmission>` of a URDF, unchecked.

    Attributes:
        joints, interfaces: all joints and hardware interfaces of the transmission.
        joint, interface: the first of each, '' if there is none.
    """

    name: str
    type: str
    joint: str
    interface: str
    has_actuator: bool
    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()


@dataclass(frozen=True)
class ControlPlugin:
    """`<plugin filename="libgazebo_ros_control.so">`; absent elements are None."""

    robot_namespace: str | None = None
    control_period: float | None = None
    e_stop_topic: str | None = None


@dataclass(frozen=True)
class Noise:
    """Noise of each pixel of a camera, in units of full scale (1.0 = 255)."""

    kind: str = "none"
    mean: float = 0.0
    stddev: float = 0.0


@dataclass(frozen=True)
class LensDescription:
    """`<lens>` of a camera.

    Attributes:
        kind, scale_to_hfov, cutoff_angle: projection of a wideanglecamera; the angle is in rad.
        intrinsics: (fx, fy, cx, cy) of other cameras in px, with the principal point measured from
            the image corner, or None.
    """

    kind: str = "gnomonical"
    scale_to_hfov: bool = True
    cutoff_angle: float = 1.5707963267948966
    intrinsics: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class DepthTopics:
    """Depth output of a depth camera.

    Attributes:
        image, info, points: topics below the camera's name; points '' for no point clouds.
        nearest, farthest: m; depths outside this range are NaN, or 0 in millimetre images.
        millimetres: whether depth images are 16UC1 instead of 32FC1.
        rows: whether a point cloud has the rows of the image instead of a single row.
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
        distortion: (k1, k2, k3, t1, t2).
        trigger_topic: '' for a camera that publishes continuously.
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
    depth: DepthTopics | None = None


@dataclass(frozen=True)
class CameraDescription:
    """A camera sensor on a link.

    Attributes:
        pose: (xyz, rpy) in the link; the camera looks along its +x axis, with z up.
        kind: camera, depth or wideanglecamera.
        distortion: (k1, k2, k3, p1, p2) of the sensor, None without a `<distortion>` element.
        distortion_center: in fractions of the image size.
        shutter: cameras of one model with the same name here expose simultaneously; '' for a
            camera that is not synchronised.
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
    noise: Noise = field(default_factory=Noise)
    distortion: tuple[float, float, float, float, float] | None = None
    distortion_center: tuple[float, float] = (0.5, 0.5)
    lens: LensDescription | None = None
    plugin: CameraPlugin | None = None
    shutter: str = ""


@dataclass(frozen=True)
class ChannelNoise:
    """Gaussian noise of one sensor channel, in its unit.

    The bias is drawn once, with a random sign.
    """

    mean: float = 0.0
    stddev: float = 0.0
    bias_mean: float = 0.0
    bias_stddev: float = 0.0


@dataclass(frozen=True)
class SensorDescription:
    """A motion or force sensor, from its plug-in and its `<sensor>`.

    Attributes:
        kind: pose (p3d), imu (in a sensor), body_imu (libgazebo_ros_imu.so), wrench, contact or
            joint_states.
        namespace: namespace of the topic; None for the model's name.
        frame: frame of the messages; '' for that of the link.
        rate: messages per second of simulated time, 0 for one in each physics step.
        link: link that a pose sensor or IMU measures, or the child of a wrench sensor's joint.
        pose: (xyz, rpy) of an IMU in its link, or of a wrench sensor in its joint.
        offset: (xyz, rpy) added to the measurement.
        noise: standard deviation of all channels.
        sample_rate: Hz; an IMU reports its mean acceleration over one such period, 0 for one step.
        from_start: whether an IMU's orientation is relative to its initial orientation.
        channels: noise of an IMU's three angular velocities and three accelerations, or of a
            wrench's three forces and three torques; () for none.
        collisions: names of the collisions whose contacts are reported.
        joints: joints whose states are published.
        joint: joint whose wrench is measured.
        wrench_frame: frame of the wrench: child, parent or sensor.
        on_child: whether the wrench acts from the parent on the child instead of the reverse.
    """

    kind: str
    topic: str
    namespace: str | None = ""
    frame: str = ""
    rate: float = 0.0
    link: str = ""
    pose: tuple[Vector3, Vector3] = (ZERO, ZERO)
    offset: tuple[Vector3, Vector3] = (ZERO, ZERO)
    noise: float = 0.0
    sample_rate: float = 0.0
    from_start: bool = False
    channels: tuple[ChannelNoise, ...] = ()
    collisions: tuple[str, ...] = ()
    joint: str = ""
    wrench_frame: str = "child"
    on_child: bool = False
    joints: tuple[str, ...] = ()


@dataclass(frozen=True)
class GraspArm:
    """A gripper: `fingers` are the links that touch an object, which is then fixed to `palm`."""

    name: str
    palm: str
    fingers: tuple[str, ...]


@dataclass(frozen=True)
class GraspDescription:
    """Settings of libgazebo_grasp_fix.so.

    Attributes:
        angle: smallest angle between two opposing forces, rad.
        rate: contact checks per second of simulated time.
        most, threshold: largest contact count, and the count above which an object is grasped.
        release_tolerance: distance that a finger may move from its contact before release, m.
        collides: whether a grasped object still collides.
    """

    arms: tuple[GraspArm, ...]
    angle: float
    rate: float
    most: int
    threshold: int
    release_tolerance: float
    collides: bool


@dataclass(frozen=True)
class LinkAttacher:
    """The world plug-in libgazebo_ros_link_attacher.so."""


def is_present(intervals: tuple[tuple[float, float], ...] | None, time: float) -> bool:
    """Return whether an object is present at `time`: within one of the intervals (begin, end], s.

    None means that the object is always present.
    """
    return intervals is None or any(begin < time <= end for begin, end in intervals)


@dataclass(frozen=True)
class Light(FramedElement):
    """A light of an SDF world.

    Attributes:
        kind: directional, point or spot.
        direction: from the light, in the world frame; for a spot in its own frame.
        attenuation_constant, attenuation_linear, attenuation_quadratic: polynomial in the distance
            in m; beyond attenuation_range the light has no effect.
        spot_inner, spot_outer: full opening angles of a spot's cones, rad.
        lit_intervals: (begin, end) of each interval in which the light is on, s of simulated time;
            None for always.
    """

    name: str
    kind: str = "directional"
    origin_xyz: Vector3 = (0.0, 0.0, 10.0)
    origin_rpy: Vector3 = ZERO
    diffuse: Rgba = (0.8, 0.8, 0.8, 1.0)
    specular: Rgba = (0.2, 0.2, 0.2, 1.0)
    direction: Vector3 = (-0.4834, 0.0967, -0.8701)
    attenuation_constant: float = 0.9
    attenuation_linear: float = 0.01
    attenuation_quadratic: float = 0.001
    attenuation_range: float = 1000.0
    spot_inner: float = 0.6
    spot_outer: float = 1.0
    spot_falloff: float = 1.0
    cast_shadows: bool = False
    lit_intervals: tuple[tuple[float, float], ...] | None = None


# The sun of Gazebo's model folder models/sun.
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9))
SHADOWS = ("none", "hard", "soft")


@dataclass(frozen=True)
class SceneSettings:
    """A world's `<scene>`.

    Attributes:
        ambient: ambient light.
        background: colour of the background.
        sky: whether a sky is drawn instead of the background colour.
        shadows: shadows in camera images: none, hard or soft.
    """

    ambient: Rgba = (0.4, 0.4, 0.4, 1.0)
    background: Rgba = (0.7, 0.7, 0.7, 1.0)
    sky: bool = False
    shadows: str = "none"


@dataclass(frozen=True)
class LoopJoint:
    """A joint that closes a kinematic chain, and its frame in both of its links.

    The joint's own `origin_*` fields are not used.
    """

    joint: Joint
    in_parent: Pose
    in_child: Pose


@dataclass(frozen=True)
class RobotDescription:
    """A whole model. Mappings have file order and are read-only.

    Attributes:
        colours: rgba of each link in camera images, from its Gazebo material ('Gazebo/Black') or
            its SDF visuals; a link without an entry is drawn white.
        static: whether the model never moves (`<gazebo><static>true`).
        warnings: one sentence for each part that was repaired or ignored, for the caller to log.
        initial_pose: (xyz, rpy) in the file (SDF only).
        initial_joints: positions (rad or m) of the joints in a world's `<state>`.
        loops: joints that close chains of the tree.
        parts: further trees of the model, which no joint connects to the first tree; the
            `initial_pose` of each is relative to the model.
    """

    name: str
    root: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    transmissions: tuple[Transmission, ...] = ()
    control_plugins: tuple[ControlPlugin, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    sensors: tuple[SensorDescription, ...] = ()
    grasps: tuple[GraspDescription, ...] = ()
    colours: Mapping[str, Rgba] = field(default_factory=lambda: MappingProxyType({}))
    static: bool = False
    warnings: tuple[str, ...] = ()
    initial_pose: tuple[Vector3, Vector3] = (ZERO, ZERO)
    initial_joints: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    loops: tuple[LoopJoint, ...] = ()
    parts: tuple[RobotDescription, ...] = ()

    def list_moving_joints(self) -> tuple[str, ...]:
        """Return the names of the joints with a degree of freedom, in file order."""
        return tuple(name for name, joint in self.joints.items() if joint.is_movable)
