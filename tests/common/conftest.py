from collections.abc import Callable

import pytest


@pytest.fixture(scope="session")
def ros_accepts() -> Callable[[str], bool]:
    """Whether ROS itself takes a relative name as that of a topic."""
    refusals = pytest.importorskip("rclpy.exceptions").InvalidTopicNameException
    relative = pytest.importorskip("rclpy.validate_topic_name").validate_topic_name
    full = pytest.importorskip("rclpy.validate_full_topic_name").validate_full_topic_name

    def accepts(name: str) -> bool:
        try:
            relative(name)
            full(f"/{name}")
        except refusals:
            return False
        return True

    return accepts
