"""Writes a recording as a bag of ROS 2 (MCAP), as if the node had published it and it was recorded.

:mod:`.bag` opens topics and keeps messages in the order of time, :mod:`.exporter` gives a stream
the topics that it has in the node, and `biosensor_common.ros` makes the messages.
"""
