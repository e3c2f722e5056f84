"""Table of the supported elements of URDF and SDF, and search for unsupported elements.

The table has one entry for each kind of block, such as "link". The entry maps each child element to
one of these:

- SUPPORTED: the element is read, or it has no effect in this simulator.
- the entry of a nested block.
- a tuple of values, usually the default. The element is unsupported if it has any other value. A
  value is a text or a number. A text that is the tag of another child of the block means the
  value of that child.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from xml.etree.ElementTree import Element

from aras_visual_servo_base.safe_xml import shorten

SUPPORTED = "served"
_OFF = ("false", "0", "no")
_ON = ("true", "1", "yes")
Entry = str | tuple | Mapping[str, "Entry"]


def _support(tags: str) -> dict[str, Entry]:
    """Return the entries of supported child elements, whose tags are separated by blanks."""
    return dict.fromkeys(tags.split(), SUPPORTED)


_NOISE = {**_support("type mean stddev bias_mean bias_stddev"), "precision": (0.0,)}
_AXES = dict.fromkeys("xyz", {"noise": _NOISE})
_CONTACT = {"soft_cfm": (0.0,), "soft_erp": (0.2,), "kp": (1e12,), "kd": (1.0,),
            "max_vel": (0.01,), "min_depth": (0.0,)}
_SURFACE = {
    "friction": {
        "ode": {
            "mu": SUPPORTED,
            "mu2": ("mu",),
            "fdir1": ("0 0 0",),
            "slip1": (0.0,),
            "slip2": (0.0,),
        },
        "torsional": {
            **_support("coefficient use_patch_radius"),
            "patch_radius": (0.0,),
            "surface_radius": (0.0,),
            "ode": {"slip": (0.0,)},
        },
    },
    "bounce": _support("restitution_coefficient threshold"),
    "contact": {
        "collide_without_contact": _OFF,
        "collide_without_contact_bitmask": (1.0,),
        "collide_bitmask": (65535.0,),
        "ode": _CONTACT,
    },
}
# Shapes that are missing here are reported by geometry_tags.read_geometry instead.
_GEOMETRY = {
    "box": _support("size"),
    "sphere": _support("radius"),
    "cylinder": _support("radius length"),
    "capsule": _support("radius length"),
    "plane": _support("normal size"),
    "mesh": {**_support("uri scale"), "submesh": _support("name center")},
    "empty": {},
}
_MATERIAL = {**_support("ambient diffuse script"), "lighting": _ON,
             "specular": ("0 0 0 1", "0 0 0 0"), "emissive": ("0 0 0 1", "0 0 0 0")}
_CAMERA = {
    **_support("pose horizontal_fov"),
    "image": _support("width height format"),
    "clip": _support("near far"),
    "noise": _support("type mean stddev"),
    "distortion": _support("k1 k2 k3 p1 p2 center"),
    "lens": {**_support("type scale_to_hfov cutoff_angle env_texture_size"),
             "intrinsics": {**_support("fx fy cx cy"), "s": (0.0,)}},
}
_SENSOR = {**_support("pose update_rate plugin always_on visualize"),
           "topic": ("", "__default_topic__", "__default__")}
_SENSORS = {
    **dict.fromkeys(("camera", "depth", "wideanglecamera", "multicamera"),
                    {**_SENSOR, "camera": _CAMERA}),
    "imu": {**_SENSOR, "imu": {"angular_velocity": _AXES, "linear_acceleration": _AXES}},
    "contact": {**_SENSOR, "contact": {"collision": SUPPORTED,
                                       "topic": ("", "__default_topic__", "__default__")}},
    "force_torque": {**_SENSOR, "force_torque": {
        **_support("frame measure_direction"), "force": _AXES, "torque": _AXES}},
}
_SDF_LINK = {
    **_support("pose gravity kinematic must_be_base_link"),
    "inertial": {**_support("mass pose"), "inertia": _support("ixx ixy ixz iyy iyz izz")},
    "visual": {"pose": SUPPORTED, "geometry": _GEOMETRY, "material": _MATERIAL, "cast_shadows": _ON,
               "transparency": (0.0,), "laser_retro": (0.0,)},
    "collision": {**_support("pose max_contacts"), "geometry": _GEOMETRY, "surface": _SURFACE,
                  "laser_retro": (0.0,)},
    "sensor": _SENSORS, "self_collide": _OFF, "enable_wind": _OFF,
    "velocity_decay": {"linear": (0.0,), "angular": (0.0,)},
}
_ODE_JOINT = {
    **_support("provide_feedback implicit_spring_damper"),
    "cfm_damping": _OFF,
    "limit": {"cfm": (0.0,), "erp": (0.2,)},
    "suspension": {"cfm": (0.0,), "erp": (0.2,)},
    "fudge_factor": (0.0,),
    "cfm": (0.0,),
    "erp": (0.2,),
    "bounce": (0.0,),
    "max_force": (0.0,),
    "velocity": (0.0,),
}
_AXIS = {
    "xyz": SUPPORTED, "initial_position": (0.0,),
    "limit": {**_support("lower upper effort velocity"), "stiffness": (1e8,),
              "dissipation": (1.0,)},
    "dynamics": _support("damping friction spring_reference spring_stiffness"),
}
_SDF_JOINT = {
    **_support("pose parent child"), "axis": _AXIS,
    "physics": {"provide_feedback": SUPPORTED, "ode": _ODE_JOINT,
                "simbody": _support("must_be_loop_joint")},
    "sensor": _SENSORS, "thread_pitch": (1.0,),
}
_TWO_AXIS_JOINT = {**_SDF_JOINT, "axis2": _AXIS}
_JOINTS = {"universal": _TWO_AXIS_JOINT, "revolute2": _TWO_AXIS_JOINT,
           "screw": {**_SDF_JOINT, "thread_pitch": SUPPORTED}}
_NAMES = _support("robotNamespace topicName updateRate alwaysOn frameName")
_OFFSETS = _support("gaussianNoise xyzOffset rpyOffset bodyName")
_CAMERA_PLUGIN = {
    **_NAMES,
    **_support(
        "cameraName imageTopicName cameraInfoTopicName hackBaseline Cx Cy CxPrime "
        "focalLength distortionK1 distortionK2 distortionK3 distortionT1 distortionT2 "
        "autoDistortion triggerTopicName"
    ),
    "borderCrop": _ON,
}
_DEPTH_PLUGIN = {
    **_CAMERA_PLUGIN, **_support(
        "depthImageTopicName depthImageCameraInfoTopicName pointCloudTopicName "
        "pointCloudCutoff useDepth16UC1Format"
    ),
}
# Supported elements of each plug-in, by the plug-in's file name without "lib" and ".so".
_PLUGINS = {
    "gazebo_ros_control": {
        **_support("robotNamespace controlPeriod eStopTopic"),
        # Accepted without effect: the model's own URDF is used instead of that in robotParam, and
        # the interfaces of joints are those of the transmissions, with or without legacyModeNS.
        **_support("robotParam legacyModeNS"),
        "robotSimType": ("gazebo_ros_control/defaultrobothwsim",),
    },
    **dict.fromkeys(
        (
            "gazebo_ros_camera",
            "gazebo_ros_multicamera",
            "gazebo_ros_triggered_camera",
            "gazebo_ros_triggered_multicamera",
        ),
        _CAMERA_PLUGIN,
    ),
    "gazebo_ros_depth_camera": _DEPTH_PLUGIN,
    "gazebo_ros_openni_kinect": {**_DEPTH_PLUGIN, "pointCloudCutoffMax": SUPPORTED},
    "gazebo_ros_p3d": {**_NAMES, **_OFFSETS},
    "gazebo_ros_imu": {**_NAMES, **_OFFSETS},
    "gazebo_ros_imu_sensor": {
        **_NAMES,
        **_OFFSETS,
        **_support("updateRateHZ initialOrientationAsReference"),
    },
    "gazebo_ros_ft_sensor": {**_NAMES, **_support("jointName gaussianNoise")},
    "gazebo_ros_bumper": {**_NAMES, "bumperTopicName": SUPPORTED},
    "gazebo_ros_joint_state_publisher": {**_NAMES, "jointName": SUPPORTED},
    "gazebo_grasp_fix": {
        "arm": _support("arm_name palm_link gripper_link"),
        **_support(
            "forces_angle_tolerance update_rate grip_count_threshold max_grip_count "
            "release_tolerance disable_collisions_on_attach"
        ),
        "contact_topic": ("", "__default_topic__"),
    },
    "gazebo_ros_link_attacher": {},
}
# Bullet's solver and contacts have other parameters than ODE's. A parameter of ODE therefore causes
# a warning unless its value is Gazebo's default.
_PHYSICS = {
    **_support("max_step_size real_time_update_rate gravity magnetic_field"),
    # Accepted without effect: as in Gazebo, max_step_size and real_time_update_rate determine the
    # real-time factor.
    "real_time_factor": SUPPORTED,
    "max_contacts": (20.0,),
    "ode": {
        "solver": {"type": ("quick",), "min_step_size": (0.0001,), "iters": (50.0,),
                   "precon_iters": (0.0,), "sor": (1.3,), "island_threads": (0.0,),
                   "use_dynamic_moi_rescaling": _OFF, "friction_model": ("pyramid_model",),
                   "thread_position_correction": _OFF},
        "constraints": {"cfm": (0.0,), "erp": (0.2,), "contact_max_correcting_vel": (100.0,),
                        "contact_surface_layer": (0.001,)},
    },
    # Accepted without effect, because Gazebo's default physics engine is ODE.
    **_support("bullet simbody dart"),
}
_SCENE = {
    **_support("ambient background origin_visual"), "grid": SUPPORTED,
    "shadows": SUPPORTED,  # accepted without effect; lights.read_scene explains why
    "sky": {"time": (10.0,), "sunrise": (6.0,), "sunset": (20.0,),
            "clouds": {"speed": (0.6,), "direction": (0.0,), "humidity": (0.5,),
                       "mean_size": (0.5,), "ambient": (".8 .8 .8 1",)}},
    "fog": {**_support("color start end density"), "type": ("none",)},
}
_WIND = {"linear_velocity": ("0 0 0",)}
# Blocks that a world contains only once, so that messages need not name their parents.
_SINGLE_BLOCKS = (_PHYSICS, _SCENE, _WIND)
BLOCKS: Mapping[str, Entry] = MappingProxyType(
    {
        "model": {
            **_support("static pose plugin allow_auto_disable frame"),
            "link": _SDF_LINK,
            "joint": _SDF_JOINT,
            "self_collide": _OFF,
            "enable_wind": _OFF,
        },
        "world": {
            **_support("model light gravity plugin state joint population include"),
            # Accepted without effect: these elements describe Gazebo's window or sensors that this
            # simulator does not have.
            **_support("gui atmosphere magnetic_field spherical_coordinates audio"),
            "frame": _support("pose"),
            "wind": _WIND,
            "physics": _PHYSICS,
            "scene": _SCENE,
        },
        **{f"plugin {name}": block for name, block in _PLUGINS.items()},
        "include": _support("name pose static uri plugin placement_frame"),
        "light": {
            **_support("pose diffuse specular direction cast_shadows"),
            "attenuation": _support("range constant linear quadratic"),
            "spot": _support("inner_angle outer_angle falloff"),
            "intensity": (1.0,),
        },
        "robot": {
            **_support("transmission material gazebo"),
            "link": {
                "inertial": SUPPORTED,
                "visual": _support("origin geometry material"),
                "collision": _support("origin geometry"),
            },
            "joint": _support(
                "origin parent child axis limit dynamics mimic safety_controller calibration"
            ),
        },
        # Elements of <gazebo> tags that have no attribute `reference`:
        "gazebo": {
            **_support("static plugin allow_auto_disable"),
            "link": _SDF_LINK,
            "joint": _SDF_JOINT,
            "self_collide": _OFF,
            "selfCollide": _OFF,
        },
        "gazebo link": {
            **_support(
                "material gravity turnGravityOff kinematic mu1 canonicalBody maxContacts "
                "max_contacts"
            ),
            "mu2": ("mu1",),
            "fdir1": ("0 0 0",),
            "selfCollide": _OFF,
            "self_collide": _OFF,
            "kp": (1e12,),
            "kd": (1.0,),
            "maxVel": (0.01,),
            "minDepth": (0.0,),
            "laserRetro": (0.0,),
            "dampingFactor": (0.0,),
            "visual": {"material": _MATERIAL},
            "collision": {"surface": _SURFACE, "max_contacts": SUPPORTED},
            "sensor": _SENSORS,
        },
        "gazebo joint": {
            **_support(
                "springStiffness springReference provideFeedback implicitSpringDamper "
                "preserveFixedJoint disableFixedJointLumping"
            ),
            "cfmDamping": _OFF,
            "stopCfm": (0.0,),
            "stopErp": (0.2,),
            "fudgeFactor": (0.0,),
            "physics": {"provide_feedback": SUPPORTED, "ode": _ODE_JOINT},
            "sensor": _SENSORS,
        },
    }
)


def describe_ignored_elements(element: Element, block: str, where: str) -> list[str]:
    """Return one sentence for each unsupported element in `element`, whose kind is `block`.

    If several places have the same unsupported element, one sentence reports them. Tags of other
    programs ("program:tag") are not reported.

    Args:
        where: name of the element in messages; '' if messages need only the names of its children.
    """
    return format_sentences(find_ignored_elements(element, block, where))


def find_ignored_elements(element: Element, block: str, where: str) -> list[tuple[str, str]]:
    """Return (place, tag) of each unsupported element in a block, in file order."""
    found: list[tuple[str, str]] = []
    _collect(element, BLOCKS[block], where, found)
    return list(dict.fromkeys(found))


def format_sentences(elements: Iterable[tuple[str, str]]) -> list[str]:
    """Return sentences that report ignored elements, given as (place, tag).

    Tags that are ignored in the same places are reported in one sentence.
    """
    places: dict[str, list[str]] = {}
    for place, tag in elements:
        places.setdefault(tag, []).append(place)
    tags: dict[tuple[str, ...], list[str]] = {}
    for tag, where in places.items():
        tags.setdefault(tuple(where), []).append(tag)
    return [f"{where[0]}{f' and {len(where) - 1} more' if len(where) > 1 else ''}: "
            + (f"{names[0]} is ignored, because it is not supported" if len(names) == 1 else
               f"{', '.join(names)} are ignored, because they are not supported")
            for where, names in tags.items()]


def _collect(element: Element, entry: Mapping[str, Entry], where: str,
             elements: list[tuple[str, str]], is_single: bool = False) -> None:
    """Add (place, tag) of the unsupported elements in `element`, whose entry is `entry`.

    `is_single` is True inside a block of _SINGLE_BLOCKS.
    """
    for child in element:
        if not isinstance(child.tag, str) or ":" in child.tag:
            continue
        inside = entry.get(child.tag)
        if inside is _SENSORS:
            # An unsupported type of sensor is not reported here, but by the reader of sensors.
            inside = _SENSORS.get(child.get("type") or "", SUPPORTED)
        if inside is _SDF_JOINT:
            inside = _JOINTS.get(child.get("type") or "", _SDF_JOINT)
        if inside is None and entry is _GEOMETRY:
            continue
        name = f" '{shorten(child.get('name'))}'" if child.get("name") else ""
        if inside is None or isinstance(inside, tuple) and not _has_value(child, inside, element):
            elements.append((where, f"<{shorten(child.tag)}>{name}"))
        elif isinstance(inside, Mapping):
            single = is_single or any(inside is one for one in _SINGLE_BLOCKS)
            label = f"{child.tag}{name}" if name or single else ""
            _collect(child, inside, ", ".join(filter(None, (where, label))), elements, single)


def _has_value(element: Element, values: tuple, block: Element) -> bool:
    """Return whether an element's value is one of `values`; see the top of this file."""
    text = _read_value(element)
    for value in map(str, values):
        sibling = block.find(value) if value.isidentifier() else None
        other = value if sibling is None else _read_value(sibling)
        if text.split() == other.split():
            return True
        numbers = _parse_numbers(text)
        if numbers is not None and numbers == _parse_numbers(other):
            return True
    return False


def _read_value(element: Element) -> str:
    return (element.get("value") or element.text or "").strip().lower()


def _parse_numbers(text: str) -> list[float] | None:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return None
