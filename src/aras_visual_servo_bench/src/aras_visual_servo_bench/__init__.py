"""Visual servoing experiments: what joins the simulator, the camera and the controller."""

from aras_visual_servo_base.moved import keep_old_names

# Documented names from before the rooms.
keep_old_names(__name__, {
    "assembly": "setup.assembly", "cameras": "asked.cameras",
    "environment": "running.environment", "experiment": "asked.experiment",
    "learned": "learning.learned", "learned_pictures": "learning.learned_pictures",
    "robots": "asked.robots", "run": "recording.run", "runner": "running.loop",
    "study.metrics": "numbers.metrics", "target_files": "targets.files",
    "textures": "targets.textures",
})  # fmt: skip
