"""The World: models that are simulated together, by Bullet or by joint_dynamics.py."""

import logging
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from aras_sim_bridge.description import shape_meshes
from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import UnknownModelError, WorldError
from aras_sim_bridge.world import bullet_files, model_checks
from aras_sim_bridge.world.attachments import Attachments
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.bullet_client import BulletClient
from aras_sim_bridge.world.collision_filters import disable_distant_pairs
from aras_sim_bridge.world.contact_forecast import ContactForecast
from aras_sim_bridge.world.friction import ContactFriction
from aras_sim_bridge.world.friction_correction import FrictionCorrection
from aras_sim_bridge.world.ground_plane import make_ground_plane
from aras_sim_bridge.world.ground_support import FIXED_BASE_ARRAYS
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.penetration_recovery import PenetrationRecovery
from aras_sim_bridge.world.physics_parameters import PhysicsParameters
from aras_sim_bridge.world.resting_base import RestingBases
from aras_visual_servo_base.poses import IDENTITY, Pose, Twist, Vector3

logger = logging.getLogger(__name__)


class World:
    """Physics world: Bullet without its hidden damping, motors and velocity limits.

    It contains models with links and joints, and simulates gravity, contacts and joint friction.
    `spawn` and `delete` change the set of models, and `step` advances them by one time step. Poses
    are in the world frame with z up. The units are m, rad, N and N m. `Simulation.world` is an
    instance of this class.

    Args:
        time_step: time step, s.
        gravity: gravity vector, m/s².
        gui: whether to open PyBullet's window.
        solver_iterations: largest number of sweeps of the constraint solver.

    Attributes:
        client: Bullet's client id, for renderers.
        models: models by name, in the order in which they were spawned. A separate part of a model,
            which no joint connects to the rest, follows it as <model>::<root link of the part>.
        revision: number of changes of the models, such as spawns, deletions and resets. A copy of
            the scene is out of date when this number has changed.
        has_bullet_steps: whether Bullet makes a step, too, in each time step.
        contact_forecast: decides which fixed-base models joint_dynamics.py steps instead of Bullet.
        resting_bases: free models at rest, whose bases are treated as fixed.
        attachments: fixed joints between links of different models.
        friction: gives each contact the smaller friction coefficient of its two links.

    Raises:
        WorldError: invalid time step or gravity, or Bullet does not start.
    """

    def __init__(self, time_step: float = 0.001, gravity: Vector3 = (0.0, 0.0, -9.8),
                 gui: bool = False, solver_iterations: int = 50) -> None:
        self._physics = PhysicsParameters(time_step, gravity, solver_iterations)
        self.models: dict[str, Model] = {}
        self._own_dynamics_models: list[Model] = []
        self._bullet_models: list[Model] = []
        self.has_bullet_steps = self._has_disabled_pairs = False
        self.contact_forecast = ContactForecast(self.models, gui)
        self.revision = 0
        self._bullet = BulletClient(gui)
        self.client = self._bullet.id
        self._gui = gui
        self.friction = ContactFriction(self.client)
        self._sliding = FrictionCorrection(self.client)
        self._deep = PenetrationRecovery(self.client, self.models)
        self.resting_bases = RestingBases(self.models, self._update_models)
        self.attachments = Attachments(self.client, self.models, self._update_attachments)
        self._physics.apply(self.client)

    @property
    def time_step(self) -> float:
        """Time step, s."""
        return self._physics.time_step

    @property
    def gravity(self) -> Vector3:
        """Gravity vector, m/s²."""
        return self._physics.gravity

    @property
    def solver_iterations(self) -> int:
        """Largest number of sweeps of the constraint solver."""
        return self._physics.solver_iterations

    def set_physics(self, time_step: float | None = None, gravity: Vector3 | None = None,
                    solver_iterations: int | None = None) -> None:
        """Change the physics parameters; a parameter that is None is not changed.

        Raises:
            WorldError: a value is invalid; nothing is changed.
        """
        changes = dict(time_step=time_step, gravity=gravity, solver_iterations=solver_iterations)
        physics = replace(
            self._physics, **{name: new for name, new in changes.items() if new is not None}
        )
        self.resting_bases.release()
        self._physics = physics
        physics.apply(self.client)
        for model in self.models.values():
            model.update_physics(physics.gravity)

    def spawn(self, description: RobotDescription, name: str, pose: Pose = IDENTITY,
              joint_positions: Mapping[str, float] | None = None,
              fixed_base: bool | None = None) -> Model:
        """Add a model to the world, at rest.

        Args:
            description: description of the model.
            name: name of the model in the world.
            pose: world_T_root.
            joint_positions: start positions by joint name, rad or m. Joints that mimic one of these
                follow; all others start at 0.
            fixed_base: whether the root link is fixed in the world. If None, it is fixed if it is
                named 'world' or marked as `<kinematic>`, or if the model is `<static>`. A root
                without mass is always fixed.

        Raises:
            WorldError: the name is taken or empty, or a pose, position or mass is invalid; the
                world is not changed.
            DescriptionError: a mesh file is damaged; the world is not changed.
        """
        if not isinstance(name, str) or not name:
            raise WorldError("a model needs a name that is not empty")
        if name in self.models:
            raise WorldError(f"a model named '{name}' exists already; delete it, or use another "
                             "name")
        whole = tuple(model_checks.fix_massless_joints(one, name)
                      for one in (description, *description.parts))
        for one in whole:
            model_checks.check_simulable(one, name)
            for text in shape_meshes.read_mesh_files(one, name):
                logger.warning("%s", text)
        pose = model_checks.check_start_pose(pose, name)
        starts = model_checks.compute_start_positions(whole, name, joint_positions or {})
        bodies = self._bullet.count_bodies()
        spawned: list[Model] = []
        try:
            for one, start in zip(whole, starts, strict=True):
                main = spawned[0] if spawned else None
                fixed = bullet_files.is_root_fixed(one, fixed_base if main is None else None)
                own_name = name if main is None else f"{name}::{one.root}"
                own_pose = pose if main is None else pose @ Pose.from_rpy(*one.initial_pose)
                spawned.append(Model(self.client, one, own_name, own_pose, start, fixed,
                                     self.gravity, self._on_model_move, main))
        except WorldError:
            self._bullet.remove_bodies(bodies)
            raise
        for model in spawned:
            self.models[model.name] = model
            self.resting_bases.release_for(model)
        self._update_models()
        logger.debug("spawned '%s': %d links, %d joints, %s base", name,
                     sum(len(model.link_names) for model in spawned),
                     sum(len(model.joint_names) for model in spawned),
                     "fixed" if spawned[0].fixed_base else "free")
        return spawned[0]

    def spawn_ground_plane(self, name: str = "ground_plane") -> Model:
        """Add Gazebo's grey ground plane, z = 0. It is infinite, but drawn 100 m wide."""
        return self.spawn(make_ground_plane(name), name)

    @property
    def main_models(self) -> dict[str, Model]:
        """Models by name, one per spawned description.

        Parts of a description that no joint connects to its root are models of their own in
        `models`; they are left out here.
        """
        return {name: model for name, model in self.models.items() if model.main_model is model}

    def model(self, name: str) -> Model:
        """Return the model called `name`.

        Raises:
            WorldError: there is no such model; the message lists all models.
        """
        model = self.models.get(name)
        if model is None or model.main_model is not model:
            raise UnknownModelError(name, self.main_models)
        return model

    def delete(self, name: str) -> None:
        """Remove a model; WorldError if it does not exist."""
        for model in self.model(name).bodies:
            self.resting_bases.release_from(model)
            self.attachments.detach_model(model)
            model.remove()
            del self.models[model.name]
        self._update_models()

    def change_model(self, name: str, description: RobotDescription) -> None:
        """Change masses, damping or limits of a model (see description_changes.py).

        The model continues from its present state.

        Raises:
            WorldError: the model does not exist, or a joint would move no mass; nothing is changed.
            DescriptionError: a mesh file has been damaged meanwhile; nothing is changed.
        """
        model = self.models.get(name) or self.model(name)
        model_checks.check_simulable(description, name)
        shape_meshes.read_mesh_files(description, name)
        self.resting_bases.release()
        self.attachments.suspend(model)
        model.rebuild(description)
        self._update_models()

    def _update_attachments(self) -> None:
        """Free all resting bases and update the world, after an attachment was added or removed."""
        self.resting_bases.release()
        self._update_models()

    def _update_models(self) -> None:
        """Update everything that depends on the models.

        This is called after a model was added, removed or changed.
        """
        self.revision += 1
        self.attachments.renew()
        self.friction.set_models(self.models.values())
        self._sliding.set_models(self.models.values())
        self._deep.start_watching()
        self._bullet.choose_solver(
            not self.attachments and all(model.fixed_base and not model.description.loops
                                         for model in self.models.values()))
        self.contact_forecast.refresh()
        self._has_disabled_pairs = False
        self._update_contact_forecast()
        self.resting_bases.refresh()

    def _on_model_move(self, model: Model, is_moved: bool, has_new_positions: bool = False) -> None:
        """Update the world after a model was changed between two steps.

        Args:
            model: the model.
            is_moved: whether the whole model was moved to another pose.
            has_new_positions: whether its joints were set to other positions. If both are False,
                the model was pushed or its twist was set.
        """
        if is_moved or has_new_positions:
            self._deep.continue_watching()
        if is_moved and model.fixed_base:
            self.resting_bases.release_from(model)
            self.contact_forecast.replace_model(model)
            self._has_disabled_pairs = False
        else:
            self.contact_forecast.steps_until_update = 0
            self._sliding.check_all()

    def _update_contact_forecast(self) -> None:
        """Choose for each model whether Bullet steps it (see contact_forecast.py)."""
        self.contact_forecast.update(self.time_step)
        models = self.models.values()
        self._own_dynamics_models = [model for model in models if model.joints.has_own_dynamics]
        self.has_bullet_steps = self._gui or any(
            not (model.fixed_base and (model.body.is_asleep or not model.joint_names))
            for model in models)
        self._bullet_models = [] if not self.has_bullet_steps else [
            model for model in models if model.needs_steps and not model.joints.has_own_dynamics]
        if self.has_bullet_steps and not self._has_disabled_pairs:
            self._has_disabled_pairs = True
            disable_distant_pairs(list(models))
            self.attachments.disable_contacts()

    def step(self) -> None:
        """Advance the physics by one time step.

        All efforts and forces act that were set since the last step.

        Raises:
            WorldError: an effort is not finite (then no model has moved), or the simulation
                diverged.
        """
        if self.resting_bases.is_new:
            self.resting_bases.fix_at_start()
        if self.contact_forecast.steps_until_update <= 0:
            self._update_contact_forecast()
        self.contact_forecast.steps_until_update -= 1
        dt = self._physics.time_step
        for model in (*self._own_dynamics_models, *self._bullet_models):
            model.check_efforts()
        for model in self._own_dynamics_models:
            model.advance(dt)
        bullet_steps = self.has_bullet_steps
        if bullet_steps:
            self._step_bullet(dt)
        if self.resting_bases.fixed_bases:
            self.resting_bases.check_support(dt, self.contact_forecast.is_base_touchable)
        if bullet_steps and self.resting_bases.is_active:
            self.resting_bases.detect_rest()

    def _step_bullet(self, dt: float) -> None:
        """Make one step of Bullet, which moves all models that joint_dynamics.py does not step."""
        for model in self._bullet_models:
            model.before_step(dt)
        if self.friction.is_active:
            self.friction.before_step()
        if self._sliding.loose:
            self._sliding.before_step(dt)
        if self._deep.is_active:
            self._deep.before_step(dt)
        pybullet.stepSimulation(self.client)
        self._bullet.is_unused = False
        if self._deep.is_active:
            self._deep.after_step(dt)
        for model in self._bullet_models:
            model.after_step()

    def get_compiled_step(self, model: Model) -> tuple[np.ndarray | float, ...] | None:
        """Return the arguments of control_cycle.run_cycles from `bodies` on, for steps of `model`.

        Return None if these compiled steps are impossible: another model has joints or may touch
        `model`, or an effort is pending.
        """
        if self.contact_forecast.steps_until_update <= 0:
            self._update_contact_forecast()
        if (
            self._own_dynamics_models != [model]
            or self._bullet_models
            or self.resting_bases.is_new
            or self.resting_bases.is_active
            or self.contact_forecast.is_base_touchable
            or not model.joints.is_calm
        ):
            return None
        space, held = model.joints.space, self.resting_bases.fixed_bases
        base_arrays = held[0].arrays[5:] if held else FIXED_BASE_ARRAYS
        return *space.arrays, self.time_step, bool(held), space.previous_speeds, *base_arrays

    def finish_compiled_steps(
        self, model: Model, count: int, diverged_joint: int = -1, is_base_supported: bool = True
    ) -> None:
        """Update the world after compiled steps of a model, and make these steps for free bodies.

        Args:
            model: model that made the steps.
            count: number of steps.
            diverged_joint: index of a joint that diverged; -1 if none did.
            is_base_supported: whether the ground supported the model's base in the last step.

        Raises:
            WorldError: the simulation diverged.
        """
        model.joints.finish_steps(diverged_joint)
        self.contact_forecast.steps_until_update -= count
        for _ in range(count if self.has_bullet_steps else 0):
            self._step_bullet(self.time_step)
        if not is_base_supported:
            self.resting_bases.release_overload()

    def reset_world(self) -> None:
        """Move all models to their spawn poses, at rest.

        As in Gazebo, the joint positions do not change.
        """
        for model in self.models.values():
            model.set_pose(model.spawn_pose)
            model.set_twist(Twist())
        self.resting_bases.refresh()

    def reset_simulation(self) -> None:
        """Reload all models into an empty Bullet, at their spawn poses and joint positions.

        All attachments are removed. After this, runs with the same inputs are identical to the last
        bit. Model objects remain valid, but their body ids may change.

        Raises:
            DescriptionError: a mesh file has been damaged meanwhile; nothing is changed.
        """
        for model in self.models.values():
            shape_meshes.read_mesh_files(model.description, model.name)
        self.resting_bases.release()
        self._bullet.reset()
        self.attachments.clear()
        self._deep.clear()
        self._physics.apply(self.client)
        for model in self.models.values():
            model.reload()
        self._update_models()

    def close(self) -> None:
        """Release the Bullet client; a second call has no effect."""
        self._bullet.close()
        self.client = -1

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
