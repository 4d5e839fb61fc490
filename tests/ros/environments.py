"""Environments with rclpy: one for each distribution of ROS 2, made of PyPI's wheels.

`make ros-environments` makes all of them. They see the packages of the environment that makes them
(NumPy, SciPy, OpenCV, pip) instead of a copy of their own.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DISTRIBUTIONS = {"jazzy": "7.1.6", "kilted": "9.1.2"}
"""With their rclpy; the other packages follow from it."""
CYCLONE = "11.0.1"
COLCON = ("colcon-core==0.21.3", "colcon-ros==0.5.0", "setuptools<80")
MESSAGES = ("nav", "sensor", "geometry", "visualization", "diagnostic", "std", "lifecycle")
PIP = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile")
GENERATORS = {
    "jazzy": (
        *("ament-cmake-ros", "ament-cmake-gmock", "ament-cmake-gtest", "ament-cmake-pytest"),
        "python-cmake-module",
    ),
    "kilted": ("ament-cmake-ros-core",),
}
MAKERS = (
    *("ament-cmake", "ament-package", "ament-cmake-include-directories"),
    *("rosidl-default-generators", "rosidl-core-generators"),
)
"""Build tools of message types: tf2_msgs has no wheel, so it is built from its one-line source."""


def environment(distribution):
    """Return the Python of an environment with rclpy; make the environment at the first call."""
    place = _place(distribution)
    python = place / "bin" / "python"
    if not (place / "installed").exists():
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
        packages = place / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
        shared = f"{sysconfig.get_path('purelib')}\n{ROOT / 'src'}\n"
        (packages / "shared.pth").write_text(shared)
        wheels = [f"ros-rclpy[fastrtps]=={DISTRIBUTIONS[distribution]}", "ros-std-srvs"]
        wheels += [f"ros-{name}-msgs" for name in MESSAGES]
        wheels += [f"ros-{name}" for name in (*MAKERS, *GENERATORS[distribution])]
        _install(str(python), *PIP, *wheels, "catkin_pkg")
        _make_tf2_msgs(place, python)
        (place / "installed").touch()
    return str(python)


def cyclone():
    """Return the folder of another vendor's DDS, for this Python: it needs nothing of ROS."""
    place = _place("cyclone")
    if not place.exists():
        _install(sys.executable, *PIP, "--target", str(place), f"cyclonedds=={CYCLONE}")
    return place


def colcon():
    """Return the program colcon, in an environment of its own: it needs nothing of ROS."""
    place = _place("colcon")
    if not (place / "installed").exists():
        subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
        _install(str(place / "bin" / "python"), *PIP, *COLCON)
        (place / "installed").touch()
    return place / "bin" / "colcon"


def _place(name):
    if "HOMEWARD_ROS" not in os.environ:
        pytest.skip("real nodes of ROS 2: make test-ros")
    return Path(f"{os.environ['HOMEWARD_ROS']}-{name}").resolve()


def _install(*command):
    """Install, or skip the test."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"cannot be installed here: {done.stderr.splitlines()[-1]}")


def _make_tf2_msgs(place, python):
    """Build tf2_msgs with the type hash of real robots; without CMake, do without tf2_msgs."""
    if shutil.which("cmake") is None:
        return
    environment = os.environ | {
        "PATH": f"{place / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(place),
    }
    build = place / "tf2_msgs"
    options = {
        "CMAKE_INSTALL_PREFIX": place,
        "CMAKE_PREFIX_PATH": place,
        "Python3_EXECUTABLE": python,
        "BUILD_TESTING": "OFF",
    }
    given = [f"-D{key}={value}" for key, value in options.items()]
    # CMake reports an error about folders of the machine that built the wheels, yet its files work.
    for command in (
        ["cmake", "-S", str(Path(__file__).parent / "tf2_msgs"), "-B", str(build), *given],
        ["make", "-C", str(build), "install"],
    ):
        subprocess.run(command, env=environment, capture_output=True)


if __name__ == "__main__":
    for make, *name in ((environment, "jazzy"), (environment, "kilted"), (cyclone,), (colcon,)):
        try:
            make(*name)
        except pytest.skip.Exception as reason:
            sys.stdout.write(f"{reason}\n")
