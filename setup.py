"""Maps the top-level folders into the one import namespace `facewright` (see ARCHITECTURE.md)."""

from setuptools import find_packages, setup

FOLDERS = (
    "core",
    "heads",
    "capture",
    "tracking",
    "speech",
    "retarget",
    "datasets_synthetic",
    "cli",
)
found = find_packages(include=[p for f in FOLDERS for p in (f, f"{f}.*")])
setup(
    packages=["facewright", *(f"facewright.{name}" for name in found)],
    package_dir={"facewright": "facewright", **{f"facewright.{f}": f for f in FOLDERS}},
)
