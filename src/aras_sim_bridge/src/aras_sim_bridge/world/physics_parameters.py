"""Parameters of the physics of a World, and the settings of Bullet that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world.bullet import pybullet
from aras_visual_servo_base.pose_checks import check_vector
from aras_visual_servo_base.poses import Vector3

# Smallest time step of the physics, s. Simulated time is counted in whole nanoseconds, so a step
# must be much longer than 1 ns.
SMALLEST_STEP = 1e-6
# Largest time step of the physics, s. With longer steps, neither PID controllers nor contacts are
# stable.
LARGEST_STEP = 0.1
# Largest component of the gravity vector, m/s²; as in Gazebo's dynamic_reconfigure.
GRAVITY_BOUND = 100.0
# Bullet's solver stops when the squared change of the impulses in one sweep is below this value.
# With Bullet's default of 1e-7, joint positions have errors of 2e-4 rad. With 1e-12, the errors are
# 6e-7 rad, and a step takes 3 us longer.
SOLVER_RESIDUAL = 1e-12


@dataclass(frozen=True)
class PhysicsParameters:
    """Parameters of the physics.

    Attributes:
        time_step: time step, s.
        gravity: gravity vector, m/s².
        solver_iterations: largest number of sweeps of the constraint solver.

    Raises:
        WorldError: a value is invalid.
    """

    time_step: float
    gravity: Vector3
    solver_iterations: int

    def __post_init__(self) -> None:
        step, sweeps = self.time_step, self.solver_iterations
        if not (isinstance(step, (int, float)) and SMALLEST_STEP <= step <= LARGEST_STEP):
            raise WorldError(
                f"time step {step} s is not in [{SMALLEST_STEP}, {LARGEST_STEP}]; use 0.001, for "
                "example"
            )
        gravity = check_vector(self.gravity, "gravity", WorldError)
        if max(abs(g) for g in gravity) > GRAVITY_BOUND:
            raise WorldError(
                f"gravity {gravity} has a component beyond ±{GRAVITY_BOUND} m/s²; reduce it"
            )
        if not 1 <= sweeps <= 10000 or sweeps != int(sweeps):
            raise WorldError(
                f"solver iterations are {sweeps}, must be a whole number from 1 to 10000"
            )
        object.__setattr__(self, "time_step", float(step))
        object.__setattr__(self, "gravity", gravity)
        object.__setattr__(self, "solver_iterations", int(sweeps))

    def apply(self, client: int) -> None:
        """Configure a Bullet client."""
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self.time_step, numSolverIterations=self.solver_iterations,
            solverResidualThreshold=SOLVER_RESIDUAL, deterministicOverlappingPairs=True,
            # Read meshes and other files again for each model, because they may have changed.
            enableFileCaching=False,
            # With split impulses, a joint may remain more than 4 cm beyond its limit (bullet3 issue
            # 2944).
            useSplitImpulse=False,
            # Apply restitution at any speed; impacts.py sets the coefficient for each impact.
            restitutionVelocityThreshold=0.0,
            # With mode 0, a pair of links is tested if the collision filters of both links accept
            # the pair. By default, one accepting filter suffices.
            collisionFilterMode=0,
            physicsClientId=client)
        pybullet.setGravity(*self.gravity, physicsClientId=client)
