"""Converts between ROS messages and streams, for the node and for bag files."""
