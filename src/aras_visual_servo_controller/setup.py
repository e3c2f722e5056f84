"""Install the Python library of this package; called by catkin, never by hand."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=[
            "aras_visual_servo_controller",
            "aras_visual_servo_controller.report",
            "aras_visual_servo_controller.schemes",
        ],
        package_dir={"": "src"},
    )
)
