from glob import glob

from setuptools import setup

NAME = "homeward_ros"

setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{kind}", glob(f"{kind}/*.*"))
            for kind in ("config", "launch", "displays")
        ),
    ],
    zip_safe=True,
    maintainer="The homeward developers",
    description="Launch files, parameters and displays of homeward",
    license="BSD-3-Clause",
    entry_points={"console_scripts": [f"homeward = {NAME}.node:main"]},
)
