"""A drive folder that is as it should be, and how to spoil it."""

VALID = {
    "odometry.csv": b"t,v,omega\n0.0,0.1,0.0\n0.5,0.1,0.2\n1.0,0.1,-0.2\n",
    "bearings.csv": b"t,landmark,bearing,sigma\n0.1,a,0.5,0.01\n0.1,b,-0.5,\n0.6,a,0.4,0.02\n",
    "home.csv": b"landmark,bearing\na,0.25\nc,-1.5\n",
    "drive.yaml": b"sensor:\n  x: 0.2\n  bearing_sigma: 0.01\nstart: {R: 1, theta: 0, alpha: 0}\n",
    "truth.csv": b"t,x,y,heading\n0.0,1.0,0.0,0.0\n1.0,1.1,0.0,0.1\n",
}


def put(folder, **changed):
    """Write the valid drive, with some files changed (dots as underscores) or, None, left out."""
    folder.mkdir(exist_ok=True)
    files = VALID | {name.replace("_", "."): content for name, content in changed.items()}
    for name, content in files.items():
        if content is not None:
            (folder / name).write_bytes(content)
    return folder
