"""Parameters of gazebo_ros and control_toolbox for dynamic_reconfigure."""

from aras_visual_servo_ros.reconfigure import ReconfigurableParameter

# Each row: name, type, default, minimum, maximum, description.
PID_FIELDS = tuple(ReconfigurableParameter(*row) for row in (
    ("p", "double", 10.0, -100000.0, 100000.0, "Proportional gain."),
    ("i", "double", 0.1, -100000.0, 100000.0, "Integral gain."),
    ("d", "double", 1.0, -1000.0, 1000.0, "Derivative gain."),
    ("i_clamp_min", "double", -10.0, -100000.0, 0.0, "Min bounds for the integral windup"),
    ("i_clamp_max", "double", 10.0, 0.0, 100000.0, "Max bounds for the integral windup"),
    ("antiwindup", "bool", False, False, True, "Antiwindup."),
))  # fmt: skip

PHYSICS_FIELDS = tuple(ReconfigurableParameter(*row) for row in (
    ("time_step", "double", 0.001, 0.0, 10.0, "Simulation time step [s]"),
    ("max_update_rate", "double", 60.0, 0.0, 1000.0,
     "Steps per second of wall time; 0: as fast as possible"),
    ("gravity_x", "double", 0.0, -100.0, 100.0, "Gravity along x [m/s^2]"),
    ("gravity_y", "double", 0.0, -100.0, 100.0, "Gravity along y [m/s^2]"),
    ("gravity_z", "double", -9.8, -100.0, 100.0, "Gravity along z [m/s^2]"),
    ("auto_disable_bodies", "bool", False, False, True, "Let resting bodies sleep"),
    ("sor_pgs_precon_iters", "int", 0, 0, 10000, "Preconditioning iterations"),
    ("sor_pgs_iters", "int", 20, 0, 10000, "Solver iterations"),
    ("sor_pgs_w", "double", 1.3, 0.0, 5.0, "Relaxation factor"),
    ("sor_pgs_rms_error_tol", "double", -1.0, -1.0, 10000.0, "Solver residual tolerance"),
    ("cfm", "double", 0.0, 0.0, 10.0, "Constraint force mixing"),
    ("erp", "double", 0.2, 0.0, 10.0, "Error reduction"),
    ("contact_surface_layer", "double", 0.001, 0.0, 10.0, "Contact layer [m]"),
    ("contact_max_correcting_vel", "double", 100.0, 0.0, 1e7, "Contact correction [m/s]"),
    ("max_contacts", "int", 100, 0, 10000000, "Contacts per body pair"),
))  # fmt: skip
