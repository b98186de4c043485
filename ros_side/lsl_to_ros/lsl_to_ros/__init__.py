"""Every LSL stream in the lab as ROS 2 topics."""
