"""libgazebo_grasp_fix: an object between two fingers is held until they release it."""

import math

import pytest
from test_gripping import box_of, gripper

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Pose

ARM = "<arm><arm_name>hand</arm_name><palm_link>palm</palm_link>{}</arm>"
FINGERS = "".join(f"<gripper_link>{side}_finger</gripper_link>" for side in ("left", "right"))
SETTINGS = "<update_rate>20</update_rate><grip_count_threshold>4</grip_count_threshold>" \
           "<max_grip_count>8</max_grip_count>"


def plugin(inside):
    return f'<gazebo><plugin name="grasp" filename="libgazebo_grasp_fix.so">{inside}</plugin>' \
           "</gazebo>"


def grasping(make, inside):
    """A gripper with this plug-in, whose fingers also open."""
    return gripper(make, mimic=False, least=-0.02, more=plugin(inside))


class Hand:
    """A gripper around a slippery box of 0.2 kg on the ground."""

    def __init__(self, simulation, make, inside):
        self.simulation = simulation
        self.box = simulation.spawn(box_of(make, 0.02), "box", Pose((0.004, 0.0, 0.03)))
        self.model = simulation.spawn(grasping(make, inside), "hand",
                                      joint_positions={"lift": -0.18})

    def go(self, steps, height, grip):
        """Move the palm towards a height while the fingers press with `grip` N."""
        for _ in range(steps):
            position, velocity = (part[0] for part in self.model.read_joints()[:2])
            self.model.apply_effort("lift", 9.8 * 1.4 + 400.0 * (height - position)
                                    - 60.0 * velocity)
            for finger in ("left", "right"):
                self.model.apply_effort(finger, grip)
            self.simulation.step()

    @property
    def box_in_palm(self):
        return self.model.link_pose("palm").inverse() @ self.box.pose()


@pytest.mark.parametrize("collides, grip", [(True, 10.0), (False, 0.0)])
def test_what_is_pressed_is_held_and_let_go(make, collides, grip):
    """The threshold of 4 counts at 20 Hz is passed 0.25 s after the fingers press. Where what is
    held touches nothing, fingers that go on pressing would pass through it."""
    extra = f"<disable_collisions_on_attach>{not collides}</disable_collisions_on_attach>"
    simulation = Simulation()
    try:
        hand = Hand(simulation, make, ARM.format(FINGERS) + SETTINGS + extra)
        (grasp,) = simulation.grasps
        hand.go(150, -0.18, 10.0)
        assert not grasp.grasped
        for _ in range(350):
            hand.go(1, -0.18, grip if grasp.grasped else 10.0)
        assert grasp.grasped["hand"].link == ("box", "box")
        before = hand.box_in_palm
        hand.go(1000, 0.1, grip)
        assert hand.box.pose().xyz[2] > 0.25
        assert math.dist(before.xyz, hand.box_in_palm.xyz) < 2e-3
        hand.go(500, 0.1, -10.0)
        assert not grasp.grasped
        hand.go(500, 0.1, -10.0)
        assert hand.box.pose().xyz[2] < 0.05
        # What was let go touches the ground again, and can be grasped again.
        assert hand.box.pose().xyz[2] > 0.01
    finally:
        simulation.close()


def test_deleted_things_and_resets_leave_nothing_held(make):
    simulation = Simulation()
    try:
        hand = Hand(simulation, make, ARM.format(FINGERS) + SETTINGS)
        (grasp,) = simulation.grasps
        hand.go(500, -0.18, 10.0)
        assert grasp.grasped
        simulation.delete("box")
        hand.go(100, -0.18, 10.0)
        assert not grasp.grasped
        simulation.reset_simulation()
        hand.go(100, -0.18, 10.0)
        simulation.delete("hand")
        assert not simulation.grasps
        simulation.step()
    finally:
        simulation.close()


@pytest.mark.parametrize("inside, words", [
    (ARM.format("<gripper_link>thumb</gripper_link>"),
     ["gripper_link 'thumb' of arm", "no valid <arm>"]),
    (ARM.format(FINGERS).replace("palm<", "wrist<"), ["palm_link 'wrist'", "no valid <arm>"]),
    (ARM.format(FINGERS) * 2, ["another arm has the same name"]),
    ("", ["no valid <arm>"]),
])
def test_arms_that_do_not_exist_are_named(make, inside, words):
    warnings = grasping(make, inside).warnings
    for word in words:
        assert sum(word in one for one in warnings) == 1, warnings


@pytest.mark.parametrize("setting, words", [
    ("<update_rate>0</update_rate>", "update_rate is 0 Hz"),
    ("<forces_angle_tolerance>60</forces_angle_tolerance>", "60 degrees"),
])
def test_impossible_settings_cost_the_plug_in_alone(make, setting, words):
    """With 60 degrees Gazebo grasps nothing either."""
    made = grasping(make, ARM.format(FINGERS) + setting)
    assert not made.grasps
    assert sum(words in one for one in made.warnings) == 1


def test_a_setting_that_is_no_number_is_refused(make):
    with pytest.raises(DescriptionError, match="max_grip_count"):
        grasping(make, ARM.format(FINGERS) + "<max_grip_count>some</max_grip_count>")
