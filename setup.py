"""For colcon, which wants this file; everything stands in setup.cfg."""

from setuptools import setup

setup()
