"""A robot that speaks another vendor's DDS, on the same wire as the node."""

import json
import sys

from ros.environments import cyclone, environment
from ros.stage import DOMAIN, HERE, Running

LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


def test_a_robot_that_speaks_cyclone_drives_home_by_the_node(tmp_path):
    python, place = environment("jazzy"), cyclone()
    node = Running(python, "-m", "homeward.ros", quiet=True)
    result = {"paths": [place], "CYCLONEDDS_URI": LOOPBACK}
    robot = Running(sys.executable, str(HERE / "cyclone_node.py"), str(DOMAIN), **result)
    try:
        end = robot.until(lambda line: True, 150.0, 0)[1]
    finally:
        robot.end()
        node.end()
    sys.stderr.write(f"\n{json.dumps(end)}\n")
    assert end["state"] == "arrived"
    assert end["distance"] < 0.05
    assert end["twists"] > 100
    assert end["poses"] > 100
    assert end["transform"] == ["map", "odom"]
