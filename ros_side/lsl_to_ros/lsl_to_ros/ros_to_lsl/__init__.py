"""The second node: sends topics of ROS as LSL streams."""
