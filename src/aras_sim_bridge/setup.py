"""Install the Python library of this package; called by catkin, never by hand."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(**generate_distutils_setup(packages=["aras_sim_bridge"], package_dir={"": "src"}))
