"""Reads and writes bags of ROS; no ROS is needed.

:mod:`.types` has the definitions of all messages, :mod:`.recorded_streams` is the topic by which a
bag that was made of a recording becomes that recording again.
"""
