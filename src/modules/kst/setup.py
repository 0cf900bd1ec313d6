"""Read by catkin and, with pyproject.toml, by pip; the wheel leaves the ros folder out."""

import sys
from xml.etree import ElementTree

from setuptools import find_packages, setup

if "setuptools.build_meta" in sys.modules:
    manifest = ElementTree.parse("package.xml")
    stated = {name: manifest.findtext(name) for name in ("version", "license")}
    setup(**stated, packages=find_packages("src", exclude=["*.ros"]), package_dir={"": "src"})
else:
    from catkin_pkg.python_setup import generate_distutils_setup

    setup(**generate_distutils_setup(packages=find_packages("src"), package_dir={"": "src"}))
