"""``python -m homeward.ros``: the node, configured and active at once unless told otherwise."""

from __future__ import annotations

import time

import rclpy
from rclpy.executors import ExternalShutdownException

from homeward.ros.node import HomewardNode

STOPPED_WITHIN_S = 0.5
"""... and that it was stopped rclpy's own thread says a moment later [s]."""


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = HomewardNode()
    try:
        if node.get_parameter("autostart").value:
            node.trigger_configure()
            node.trigger_activate()
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
