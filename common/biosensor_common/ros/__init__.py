"""Turns messages of ROS into the numbers of a stream, for the node and for bags alike."""
