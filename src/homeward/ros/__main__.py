"""``python -m homeward.ros``: run the node, configured and activated at once by default."""

from __future__ import annotations

import sys
import time

BAD_INPUT = 2
HELP = """usage: python -m homeward.ros [--ros-args -p NAME:=VALUE ... --params-file FILE]

The lifecycle node of homeward, configured and activated at once. docs/do/live.md describes its
topics, ros/homeward_ros/config/homeward.yaml every parameter."""
SHUTDOWN_S = 0.5
"""Time within which rclpy's thread reports the shutdown after such an error [s]."""


def main() -> None:
    """Run the node until it is stopped; exit at once if autostart fails."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        sys.stdout.write(HELP + "\n")
        return
    try:
        import rclpy
        from rclpy.exceptions import ParameterException
        from rclpy.executors import ExternalShutdownException

        from homeward.ros.node import DONE, HomewardNode
    except ImportError as error:
        remedy = "source /opt/ros/DISTRO/setup.bash first, with the Python of that distribution"
        sys.stderr.write(f"homeward.ros: {error}: {remedy}\n")
        raise SystemExit(BAD_INPUT) from None
    rclpy.init()
    try:
        node = HomewardNode()
    except ParameterException as error:  # a value of another type
        sys.stderr.write(f"homeward.ros: {error}\n")
        rclpy.try_shutdown()
        raise SystemExit(BAD_INPUT) from None
    try:
        starts = node.get_parameter("autostart").value
        if starts and not (node.trigger_configure() == DONE == node.trigger_activate()):
            raise SystemExit(BAD_INPUT)  # the reason is in the log
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:  # rclpy may raise it when interrupted
        time.sleep(SHUTDOWN_S)
        if rclpy.ok():
            raise
    finally:
        node.on_shutdown(None)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
