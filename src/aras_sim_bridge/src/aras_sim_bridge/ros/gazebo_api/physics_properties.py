"""Services get/set_physics_properties and the dynamic_reconfigure server of /gazebo.

Only gravity, time step, update rate and solver iterations have an effect, because Bullet has no
counterpart to most parameters of ODE. The other values are stored, so that clients read what they
have written.
"""

from __future__ import annotations

import math

import rospy
from gazebo_msgs.msg import ODEPhysics
from gazebo_msgs.srv import GetPhysicsProperties, SetPhysicsProperties
from geometry_msgs.msg import Vector3

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.conversions import from_vector
from aras_sim_bridge.ros.runtime.reconfigure_parameters import PHYSICS_FIELDS
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import ReconfigureServer

# Names of values in dynamic_reconfigure. Those of ODE are also the names in the message.
GRAVITY_FIELDS = ("gravity_x", "gravity_y", "gravity_z")
ODE_FIELDS = tuple(ODEPhysics.__slots__)


class PhysicsProperties:
    """Physics properties, which services and dynamic_reconfigure read and set."""

    def __init__(self, namespace: str, thread: SimulationThread) -> None:
        """Start the dynamic_reconfigure server in `namespace`."""
        self._thread = thread
        # Present values by their parameter names in dynamic_reconfigure.
        self._values = thread.call(self._read_initial_values)
        self._server = ReconfigureServer(
            namespace, PHYSICS_FIELDS, self._values, self._reconfigure
        )

    def _read_initial_values(self) -> dict[str, Value]:
        world = self._thread.simulation.world
        return {
            "time_step": world.time_step,
            "max_update_rate": self._thread.pacer.factor / world.time_step,
            **dict(zip(GRAVITY_FIELDS, world.gravity, strict=True)),
            "auto_disable_bodies": False,
            "sor_pgs_precon_iters": 0,
            "sor_pgs_iters": world.solver_iterations,
            "sor_pgs_w": 1.3,
            "sor_pgs_rms_error_tol": 0.0,
            "contact_surface_layer": 0.001,
            "contact_max_correcting_vel": 100.0,
            "cfm": 0.0,
            "erp": 0.2,
            "max_contacts": 20,
        }

    @service_handler(GetPhysicsProperties, "got properties")
    def get_physics_properties(
        self, simulation: Simulation, _request: GetPhysicsProperties
    ) -> Fields:
        """Return the current physics properties.

        They include the parameters of ODE, which are stored but have no effect.
        """
        values, world = self._values, simulation.world
        return {
            "time_step": world.time_step,
            "pause": self._thread.paused,
            "max_update_rate": values["max_update_rate"],
            "gravity": Vector3(*world.gravity),
            "ode_config": ODEPhysics(**{name: values[name] for name in ODE_FIELDS}),
        }

    @service_handler(SetPhysicsProperties, "physics engine updated", in_caller_thread=True)
    def set_physics_properties(
        self, _thread: SimulationThread, request: SetPhysicsProperties
    ) -> Fields:
        """Set all physics properties."""
        gravity = from_vector(request.gravity, "gravity")
        values = {
            "time_step": request.time_step,
            "max_update_rate": request.max_update_rate,
            **dict(zip(GRAVITY_FIELDS, gravity, strict=True)),
            **{name: getattr(request.ode_config, name) for name in ODE_FIELDS},
            # As in gazebo_ros, this service does not change sor_pgs_rms_error_tol.
            "sor_pgs_rms_error_tol": self._values["sor_pgs_rms_error_tol"],
        }
        self._apply(values)
        self._server.set_values(values)
        warning = self._thread.call(lambda: _report_stability(self._thread.simulation))
        text = "SetPhysicsProperties: physics engine updated"
        return {"status_message": f"{text}; {warning}"} if warning else None

    def _reconfigure(self, values: dict[str, Value]) -> None:
        if values != self._values:
            self._apply(values)

    def _apply(self, values: dict[str, Value]) -> None:
        """Change the physics to values that are given by their names in dynamic_reconfigure."""
        for name in ("max_update_rate", *ODE_FIELDS):
            if not math.isfinite(values[name]):
                raise WorldError(f"{name} is {values[name]}; give a finite number")
        for field in PHYSICS_FIELDS:
            # Check integers here, because the messages of the services also allow values that
            # exceed the limits of dynamic_reconfigure.
            if field.type == "int" and not field.minimum <= values[field.name] <= field.maximum:
                raise WorldError(f"{field.name} is {values[field.name]}; give a whole number from "
                                 f"{field.minimum} to {field.maximum}")
        time_step, rate = values["time_step"], values["max_update_rate"]
        if rate < 0:
            raise WorldError(f"max_update_rate is {rate}; give 0 (as fast as possible) or more")

        def job() -> None:
            simulation = self._thread.simulation
            gravity = tuple(values[name] for name in GRAVITY_FIELDS)
            simulation.set_physics(time_step, gravity, max(int(values["sor_pgs_iters"]), 1))
            self._thread.pacer.set_factor(rate * time_step, simulation.time_ns)
            self._values = dict(values)
            if warning := _report_stability(simulation):
                rospy.logwarn("%s", warning)

        self._thread.call(job)


def _report_stability(simulation: Simulation) -> str:
    """Return warnings for robots whose PIDs are unstable with the current time step."""
    step = simulation.world.time_step
    return "; ".join(
        filter(None, (robot.report_stability(step) for robot in simulation.robots.values()))
    )
