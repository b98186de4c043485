"""Exports a recording to a ROS 2 bag (MCAP), as if the node had published it.

:mod:`.bag` opens topics and sorts messages by time, :mod:`.exporter` writes each stream to the
topics that it has in the node, and `biosensor_common.ros` creates the messages.
"""
