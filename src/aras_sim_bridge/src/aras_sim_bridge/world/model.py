"""Model: one robot or object in the World, its joints and its link frames.

Its parts are the layers it is derived from: model_loading.py, on it model_joints.py, on that
model_frames.py. Here is what needs all of them.
"""


from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model_frames import ModelFrames


class Model(ModelFrames):
    """A spawned description. Made by `World.spawn`; stays the same object over resets.

    joint_names: moving joints (mimicking ones too) in file order; every sequence of joint values
    is in this order. link_names: all links in file order, root first or not.
    Efforts are set for one step and gone after it, as a simulator's are.
    """

    def rebuild(self, description: RobotDescription) -> None:
        """Go on from the present state as `description`: the same links and joints, other numbers.

        Bullet cannot move a centre of mass; so the body is loaded anew, with a new body id.
        """
        states = [pybullet.getJointState(self.body_id, i, self.client)[:2]
                  for i in self._bullet_joint]
        pose, twist = self.link_state(self.description.root)
        self.remove()
        self._describe(description)
        self._load()
        self.set_pose(pose)
        if not self.fixed_base:
            self.set_twist(twist)
        for index, (position, velocity) in zip(self._bullet_joint, states, strict=True):
            pybullet.resetJointState(self.body_id, index, position, velocity,
                                     physicsClientId=self.client)
        self._joint_cache = None

    def before_step(self, dt: float) -> None:
        """Hand the pending efforts, which are finite, to Bullet; called by `World.step`."""
        if self.joint_names:
            efforts = self.pending_efforts
            torques = self._damping.before_step(dt)
            if self._dirty or torques is not None:
                total = efforts if torques is None else [
                    e + t for e, t in zip(efforts, torques.tolist(), strict=True)
                ]
                pybullet.setJointMotorControlArray(
                    self.body_id, self._bullet_joint, pybullet.TORQUE_CONTROL, forces=total,
                    physicsClientId=self.client)
            self._applied, self.pending_efforts = efforts, [0.0] * len(efforts)
            self._dirty = False
        if self._weightless:
            self._carry_weightless()

    @property
    def needs_steps(self) -> bool:
        """Whether `before_step` has anything to do, ever."""
        return bool(self.joint_names or self._weightless)

    def physics_changed(self) -> None:
        """Time step or gravity was changed; called by `World.set_physics`."""
        self._damping.changed()

    def after_step(self) -> None:
        """Forget what was read before the step; called by `World.step`."""
        self._joint_cache = None

    def _carry_weightless(self) -> None:
        for name, mass in self._weightless.items():
            centre = self.link_pose(name).apply(self._inertial_poses[name].xyz)
            self.apply_force(name, tuple(-mass * g for g in self.gravity), centre)
