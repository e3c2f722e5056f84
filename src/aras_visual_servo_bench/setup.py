"""Install the Python library of this package; called by catkin, never by hand."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

setup(**generate_distutils_setup(
    packages=find_packages("src"),
    package_dir={"": "src"},
    package_data={
        "aras_visual_servo_bench.studies": ["*.jinja"],
        "aras_visual_servo_bench.web": ["page/*"], "aras_visual_servo_bench.web.live": ["page/*"],
        "aras_visual_servo_bench.web.report": ["page/*"],
        "aras_visual_servo_bench.web.browse": ["page/*"],
    },
))  # fmt: skip
