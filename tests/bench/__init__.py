"""``make bench``: latency from LSL to ROS against its two floors, and the speed of a parser."""
