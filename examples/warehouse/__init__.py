"""A robot in a warehouse with physics; see README.md."""

import sys
from importlib.util import find_spec

if sys.argv[0] == "-m" and find_spec("mujoco") is None:
    raise SystemExit(
        "the warehouse with physics needs MuJoCo: use `make demo-physics`, or"
        " `pip install -c constraints.txt -e '.[demo-physics]'`"
    )
