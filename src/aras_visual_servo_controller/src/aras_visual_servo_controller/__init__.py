"""Visual servoing of the ARAS robot."""

from aras_visual_servo_base.moved import keep_old_names

# Documented names from before the rooms.
keep_old_names(__name__, {
    "driver": "driving.driver", "goal": "goals.goal", "observation": "seeing.observation",
    "servo": "loop.servo", "starts": "goals.starts", "state": "loop.state",
    "target_geometry": "seeing.target_geometry", "task": "arm.task", "teaching": "loop.teaching",
})  # fmt: skip
