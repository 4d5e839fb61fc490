"""``python -m homeward.ros``: the node, configured and active at once unless told otherwise."""

from __future__ import annotations

import sys
import time

BAD_INPUT = 2
HELP = """usage: python -m homeward.ros [--ros-args -p NAME:=VALUE ... --params-file FILE]

The lifecycle node of homeward, configured and active at once. docs/do/live.md describes its
topics, docs/do/ros/homeward.yaml every parameter."""
STOPPED_WITHIN_S = 0.5
"""... and that it was stopped rclpy's own thread says a moment later [s]."""


def main() -> None:
    """Run the node until it is stopped; one that starts by itself and cannot ends at once."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        sys.stdout.write(HELP + "\n")
        return
    try:
        import rclpy
        from rclpy.executors import ExternalShutdownException

        from homeward.ros.node import DONE, HomewardNode
    except ImportError as error:
        way = "source /opt/ros/DISTRO/setup.bash first, in a Python that the distribution supports"
        sys.stderr.write(f"homeward.ros: {error}: {way}\n")
        raise SystemExit(BAD_INPUT) from None
    rclpy.init()
    node = HomewardNode()
    try:
        starts = node.get_parameter("autostart").value
        if starts and not (node.trigger_configure() == DONE == node.trigger_activate()):
            raise SystemExit(BAD_INPUT)  # the log says why
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:  # what is interrupted within rclpy may end by that, ...
        time.sleep(STOPPED_WITHIN_S)
        if rclpy.ok():
            raise
    finally:
        node.on_shutdown(None)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
