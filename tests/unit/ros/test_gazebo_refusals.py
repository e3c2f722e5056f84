"""Requests to gazebo_ros's services that are refused, with the reason; nothing changes."""

import math

import pytest
from gazebo_msgs.msg import LinkState, ModelState, ODEJointProperties
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3, Wrench
from std_msgs.msg import ColorRGBA
from stepped_models import BALL

NAN, INF = math.nan, math.inf
LIGHT = '<light name="spot" type="spot"><diffuse>1 0.5 0.25 1</diffuse></light>'
MODEL = '<model name="m"><static>true</static><link name="l"/></model>'
SDF = '<sdf version="1.6">{}</sdf>'


def at(x: float, y: float = 0.0, z: float = 0.0, qx: float = 0.0, qw: float = 1.0) -> Pose:
    return Pose(Point(x, y, z), Quaternion(qx, 0.0, 0.0, qw))


def wrench(y: float) -> Wrench:
    return Wrench(force=Vector3(0.0, y, 0.0))


def ball(**state: object) -> dict:
    return {"model_state": ModelState(model_name="ball", **state)}


def link(**values: object) -> dict:
    return {"link_name": "cart", "mass": 1.0, "ixx": 1.0, "iyy": 1.0, "izz": 1.0, **values}


def joint(**config: list) -> dict:
    return {"joint_name": "rail", "ode_joint_config": ODEJointProperties(**config)}


def rail(*positions: float) -> dict:
    return {"model_name": "slider", "joint_names": ["rail"], "joint_positions": positions}


def urdf(xml: str, name: str = "m", **more: object) -> dict:
    return {"model_name": name, "model_xml": xml, **more}


REFUSED = [  # (service, fields, what the reason says)
    ("get_model_state", {"model_name": "ghost"}, "ghost"), ("get_model_state", {}, "''"),
    ("get_model_state", {"model_name": "ball", "relative_entity_name": "ghost"}, "ghost"),
    ("get_model_properties", {"model_name": "ghost"}, "ghost"),
    ("get_link_state", {"link_name": "ball::ghost"}, "ghost"),
    ("get_link_state", {"link_name": "ball", "reference_frame": "ghost"}, "ghost"),
    ("get_link_state", {"link_name": "::"}, "::"), ("get_link_properties", {}, "''"),
    ("get_joint_properties", {"joint_name": "slider::ghost"}, "ghost"),
    ("get_light_properties", {"light_name": "ghost"}, "ghost"),
    ("set_model_state", {"model_state": ModelState(model_name="ghost")}, "ghost"),
    ("set_model_state", ball(reference_frame="ghost"), "ghost"),
    ("set_model_state", ball(twist=Twist(linear=Vector3(INF, 0, 0))), "linear"),
    *[("set_model_state", ball(pose=pose), "pose of 'ball") for pose in (
        at(1e9), at(NAN), at(0.0, -2e6), at(0.0, qw=1e-9), at(0.0, qx=NAN))],
    *[("set_link_state", {"link_state": LinkState("ball::ball", pose, Twist(), "")}, "pose of 'ball"
       ) for pose in (at(1.0, 2.0, 3.0, qw=0.0), at(1e9), at(0.0, -2e6), at(0.0, qw=1e-9))],
    ("set_link_state", {}, "''"),
    ("set_link_state", {"link_state": LinkState(link_name="slider::cart")},
     "is not the root link of 'slider'"),
    ("set_model_configuration", {"model_name": "ghost"}, "ghost"),
    ("set_model_configuration", rail(), "the request has 1 joint_names but 0"),
    *[("set_model_configuration", rail(q), "joint_positions: joint 'rail' of 'slider'")
      for q in (1e9, -2e6, INF, NAN)],
    ("set_link_properties", link(link_name="ghost"), "ghost"),
    *[("set_link_properties", link(mass=mass), "mass") for mass in (-1.0, NAN, 0.0)],
    ("set_link_properties", link(ixx=-1.0), "inertia"),
    ("set_joint_properties", {"joint_name": "ghost"}, "ghost"),
    ("set_joint_properties", joint(damping=[-1.0]), "damping"),
    ("set_joint_properties", joint(fmax=[1.0, 2.0]), "fmax has 2 numbers"),
    ("set_joint_properties", joint(hiStop=[-2.0]), "stop"),
    ("set_joint_properties", joint(vel=[1.0]), "with a controller"),
    ("set_light_properties", {"light_name": "ghost"}, "ghost"),
    ("set_light_properties", {"light_name": "sun", "diffuse": ColorRGBA(-1, 0, 0, 1)}, "diffuse"),
    ("set_light_properties", {"light_name": "sun", "attenuation_constant": NAN},
     "attenuation_constant"),
    ("delete_light", {"light_name": "ghost"}, "ghost"),
    ("delete_model", {"model_name": "ghost"}, "existing models: ground_plane, slider, ball"),
    ("apply_body_wrench", {"body_name": "slider::ghost"}, "ApplyBodyWrench: link 'slider::ghost'"),
    ("apply_body_wrench", {"body_name": "slider::box"}, "has no mass"),
    *[("apply_body_wrench", {"body_name": "ball", "wrench": wrench(y)}, "force")
      for y in (NAN, 1.1e9)],
    ("apply_body_wrench", {"body_name": "ball", "reference_frame": "ghost"}, "ghost"),
    ("apply_joint_effort", {"joint_name": "bolt", "effort": 1.0}, "'bolt' does not move"),
    *[("apply_joint_effort", {"joint_name": "rail", "effort": effort}, "'rail'")
      for effort in (1e300, INF)],
    *[("step_world", {"steps": steps}, "1 to 1000000") for steps in (0, 1_000_001)],
    *[("spawn_urdf_model", urdf(BALL, initial_pose=pose), "'m'") for pose in (
        at(1e9), at(0.0, -2e6), at(0.0, qw=1e-9), at(0.0, qx=NAN))],
    *[("spawn_urdf_model", urdf(BALL, name), words) for name, words in (
        ("", "is empty"), ("a::b", "not contain '::'"), ("x" * 257, f"{60 * 'x'}"),
        ("ball", "SpawnModel: "))],
    ("spawn_urdf_model", urdf(BALL, reference_frame="nowhere"), "reference frame 'nowhere'"),
    *[("spawn_urdf_model", urdf(text), words) for text, words in (
        ("<sdf/>", "the model's root is <sdf>, not <robot>"),
        ("", "the model's root is no element"),
        (BALL.replace("<inertial>", "package://no_such_package/x<inertial>"), "no_such_package"),
        (BALL.replace("</robot>", "<gazebo><a>package://nowhere/a</a></gazebo></robot>"),
         "'nowhere'"),
        (BALL.replace("</robot>", "<gazebo a='package://nowhere'/></robot>"), "'nowhere'"))],
    *[("spawn_sdf_model", urdf(text), words) for text, words in (
        (SDF.format(MODEL + LIGHT), "SpawnModel: SDF: the text has 1 models and 1 lights; it must "
         "contain exactly one model"),
        (SDF.format(""), "SpawnModel: SDF: the text contains no <model> and no <light>; add one"),
        ("<model/>", "the model's root is <model>; give URDF (<robot>) or SDF"),
        ("", "the model's root is no element; give URDF (<robot>) or SDF"))],
    *[(f"spawn_{kind}_model", urdf(text), words) for kind in ("urdf", "sdf") for text, words in (
        ("<!--" * 1_000_000, "not well-formed"),  # looked through once, not once for each beginning
        ("<robot name='r'><link name='a'></robot>", "mismatched tag"),
        ("<!DOCTYPE robot><robot name='r'/>", "DOCTYPE"),
        (" " * (1 << 24) + "<robot/>", "more than the limit"))]]


@pytest.fixture
def state(call, slider, ball):
    """Function that returns all that a refused request must leave as it was."""
    asks = (("get_world_properties",), ("get_physics_properties",), ("get_model_state", "ball"),
            ("get_joint_properties", "rail"), ("get_link_properties", "cart"),
            ("get_light_properties", "sun"))

    def read() -> list[str]:
        answers = [call(*ask) for ask in asks]
        answers[2].header.seq = 0  # of which every answer has another
        return [str(answer) for answer in answers]

    return read


def test_requests_are_refused_with_the_reason_and_nothing_changes(api, call, state):
    before = state()
    for service, fields, words in REFUSED:
        reason = call(service, refused=True, **fields).status_message
        assert words in reason and len(reason) < 300 and "x" * 61 not in reason, (service, reason)
        assert api.graph.lines[-1].startswith(f"/gazebo/{service}: ")
    assert state() == before


@pytest.mark.parametrize(("change", "ode", "words"), [
    ({"max_update_rate": -1.0}, {}, "max_update_rate is -1"),
    ({"max_update_rate": INF}, {}, "finite"), ({"time_step": 0.0}, {}, "step"),
    ({"gravity": Vector3(0.0, NAN, 0.0)}, {}, "gravity"),
    *[({}, {name: value}, f"{name} is {value}; give a whole number from 0 to {most}")
      for name, value, most in (("sor_pgs_precon_iters", 4294967295, 10000),
                                ("sor_pgs_iters", 10001, 10000),
                                ("max_contacts", 4294967295, 10000000))]])
def test_physics_that_cannot_be(call, change, ode, words):
    before = call("get_physics_properties")
    changed = call("get_physics_properties").ode_config
    for name, value in ode.items():
        setattr(changed, name, value)
    given = {"time_step": 0.001, "max_update_rate": 1000.0, "gravity": before.gravity,
             "ode_config": changed, **change}
    assert words in call("set_physics_properties", refused=True, **given).status_message
    assert call("get_physics_properties") == before
