"""The second node: sends ROS topics as LSL streams."""
