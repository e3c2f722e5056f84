"""SDF poses relative to a link, joint, frame or model are equal to absolute poses."""

import re

import numpy as np
import pytest

from aras_sim_bridge.description import parse_sdf, read_sdf
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose

A, B, C = (Pose.from_rpy(*at) for at in (((1, 2, 3), (0.3, -0.2, 0.5)),
                                         ((4, -5, 6), (-0.6, 0.1, 0.2)),
                                         ((0.5, 0.1, -0.2), (0.2, 0.4, -0.9))))


def pose(at, frame=None):
    numbers = " ".join(map(repr, (*at.xyz, *at.rpy)))
    return f"<pose{f' relative_to={frame!r}' if frame is not None else ''}>{numbers}</pose>"


BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
JOINT = ("<joint name='j' type='revolute'>{pose}<parent>{parent}</parent><child>{child}</child>"
         "<axis><xyz{frame}>0 1 0</xyz></axis></joint>")


def model(inside, attributes=""):
    return parse_sdf(f"<sdf version='1.8'><model name='m'{attributes}>{inside}</model></sdf>")


def joint(at="", parent="a", child="b", frame=""):
    return JOINT.format(pose=at, parent=parent, child=child,
                        frame=f" expressed_in='{frame}'" if frame else "")


def assert_same(given, expected):
    """Check that links, joints and shapes have the same poses, to rounding."""
    assert not given.warnings and not expected.warnings
    assert list(given.links) == list(expected.links) and given.root == expected.root
    assert list(given.joints) == list(expected.joints)
    pairs = [(given.joints[name], expected.joints[name]) for name in given.joints]
    for one, other in pairs:
        assert (one.kind, one.parent, one.child) == (other.kind, other.parent, other.child)
        np.testing.assert_allclose(one.axis, other.axis, atol=1e-12)
    for name, link in given.links.items():
        other = expected.links[name]
        pairs += zip((*link.visuals, *link.collisions, link.inertial),
                     (*other.visuals, *other.collisions, other.inertial), strict=True)
    for one, other in pairs:
        if one is not None:
            np.testing.assert_allclose(one.pose.matrix(), other.pose.matrix(), atol=1e-12)
    for one, other in zip(given.cameras, expected.cameras, strict=True):
        assert np.ravel(one.pose) == pytest.approx(np.ravel(other.pose))
    assert np.ravel(given.initial_pose) == pytest.approx(np.ravel(expected.initial_pose))


def links(second, inside=""):
    return f"<link name='a'>{pose(A)}</link><link name='b'>{second}{inside}</link>"


@pytest.mark.parametrize(("given", "expected"), [
    (links(pose(B, "a")) + joint(), links(pose(A @ B)) + joint()),
    (links(pose(B, "f")) + f"<frame name='f' attached_to='a'>{pose(C)}</frame>" + joint(),
     links(pose(A @ C @ B)) + joint()),
    (links(pose(B, "f")) + f"<frame name='f'>{pose(C, 'g')}</frame><frame name='g' "
     "attached_to='a'/>" + joint(), links(pose(A @ C @ B)) + joint()),
    # of a joint: by the model, a link and a frame; a link by a joint, whose frame is its child's
    (links(pose(B)) + joint(pose(C, "__model__")), links(pose(B)) + joint(pose(B.inverse() @ C))),
    (links(pose(B)) + joint(pose(C, "a")), links(pose(B)) + joint(pose(B.inverse() @ A @ C))),
    (links(pose(B)) + joint(pose(A)) + f"<link name='c'>{pose(C, 'j')}</link>"
     + joint(child="c").replace("'j'", "'k'"),
     links(pose(B)) + joint(pose(A)) + f"<link name='c'>{pose(B @ A @ C)}</link>"
     + joint(child="c").replace("'j'", "'k'")),
    # between frames
    (links(pose(B)) + joint(parent="f", child="g")
     + f"<frame name='f' attached_to='a'>{pose(A)}</frame>"
     f"<frame name='g' attached_to='b'>{pose(C)}</frame>", links(pose(B)) + joint(pose(C))),
    (links(pose(B)) + f"<frame name='f' attached_to='a'>{pose(C)}</frame>" + joint(frame="f"),
     links(pose(B)) + joint(frame="a").replace(
         "0 1 0", " ".join(map(repr, Pose((0, 0, 0), C.quat).apply((0, 1, 0)))))),
])
def test_links_and_joints_by_frames(given, expected):
    assert_same(model(given), model(expected))


@pytest.mark.parametrize("tag", ["visual", "collision", "inertial", "sensor"])
@pytest.mark.parametrize(("frame", "at"), [
    ("a", B.inverse() @ A), ("__model__", B.inverse()), ("f", B.inverse() @ A @ C), ("b", Pose())])
def test_what_is_in_a_link_by_frames(tag, frame, at):
    inside = {"inertial": "<mass>2</mass>", "sensor": "<camera name='c'/>"}.get(tag, BOX)
    part = f"<{tag} name='p' type='camera'>{{}}{inside}</{tag}>"
    rest = joint() + f"<frame name='f' attached_to='a'>{pose(C)}</frame>"
    given = model(links(pose(B), part.format(pose(A, frame))) + rest)
    assert_same(given, model(links(pose(B), part.format(pose(at @ A))) + rest))


@pytest.mark.parametrize("frame", ["in::a", "in::f", "in"])
def test_models_in_models_by_frames(frame):
    inner = (f"<model name='in'>{pose(B, 'f')}<link name='a'>{pose(A)}</link><frame name='f' "
             f"attached_to='a'>{pose(C)}</frame></model>")
    place = C @ B @ {"in::a": A, "in::f": A @ C, "in": Pose()}[frame]
    rest = joint(parent="in::a", child="l")
    given = model(f"<link name='l'>{pose(A, frame)}</link>{inner}<frame name='f'>{pose(C)}</frame>"
                  + rest)
    assert_same(given, model(
        f"<link name='l'>{pose(place @ A)}</link><model name='in'>{pose(C @ B)}<link name='a'>"
        f"{pose(A)}</link></model>" + rest))


def test_models_are_placed_by_frames_and_by_models():
    box = "<model name='{}'>{}<link name='l'>{}</link></model>"
    found = read_sdf("<sdf><world name='w'>" + box.format("p", pose(C, "q::l"), "")
                     + box.format("q", pose(B, "f"), pose(C)) + f"<frame name='f'>{pose(A)}</frame>"
                     f"<frame name='g' attached_to='f'>{pose(C)}</frame><light name='k'>"
                     f"{pose(B, 'g')}</light></world></sdf>")
    assert not found.warnings
    np.testing.assert_allclose(found.lights[0].pose.matrix(), (A @ C @ B).matrix(), atol=1e-12)
    for one, at in zip(found.models, (A @ B @ C @ C, A @ B), strict=True):
        np.testing.assert_allclose(Pose.from_rpy(*one.initial_pose).matrix(), at.matrix(),
                                   atol=1e-12)
    inside = f"{pose(B)}<link name='a'>{pose(A)}</link>"
    placed = model(inside, " placement_frame='a'")
    np.testing.assert_allclose(Pose.from_rpy(*placed.initial_pose).matrix(),
                               (B @ A.inverse()).matrix(), atol=1e-12)


@pytest.mark.parametrize(("inside", "reason"), [
    (links(pose(B, "x")) + joint(), "link 'b': <pose relative_to='x'> names no link, joint"),
    (links(pose(B, "b")) + joint(), "link 'b': <pose relative_to='b'> names no link, joint"),
    (links(pose(B, "f")) + "<frame name='f' attached_to='b'/>" + joint(),
     "link 'b': <pose relative_to='f'> names no link, joint"),
    (links(pose(B), f"<visual name='v'>{pose(A, 'x')}{BOX}</visual>") + joint(),
     "visual 'v': <pose relative_to='x'> names no link, joint"),
    (links(pose(B)) + joint(pose(C, "x")), "joint 'j': <pose relative_to='x'> names no link"),
    (links(pose(B)) + joint(parent="f") + "<frame name='f'/>", "joint 'j': link 'f' does not"),
    (links(pose(B)) + joint(frame="x"), "<xyz expressed_in='x'> names no link")])
def test_a_frame_that_does_not_exist_is_named(inside, reason):
    with pytest.raises(DescriptionError, match=reason):
        model(inside)
    found = read_sdf(f"<sdf><world name='w'><model name='m'>{inside}</model><model name='n'>"
                     "<link name='l'/></model></world></sdf>")
    assert [one.name for one in found.models] == ["n"]
    assert any(reason in text for text in found.warnings)


def test_frames_that_cannot_be_are_named_with_their_error():
    """In a world and in a model, and what is placed in the frame names the same error."""
    frame = "<frame name='f'><pose>1 2</pose></frame>"
    cause = r"frame 'f': pose\b.* 6"
    inside = "<model name='m'><pose relative_to='f'/><link name='a'/></model>"
    world = read_sdf(f"<sdf version='1.8'><world name='w'>{frame}{inside}</world></sdf>")
    assert not world.models and len(world.warnings) == 2
    for text in world.warnings:
        assert re.search(cause, text), text
    (text,) = model(f"<link name='a'/>{frame}").warnings
    assert re.search(cause, text), text
    (line,) = model("<link name='l'/><frame name='f' attached_to='g'/>").warnings
    assert line.startswith("model 'm': frame 'f' is ignored: its base 'g' is no link, joint")
