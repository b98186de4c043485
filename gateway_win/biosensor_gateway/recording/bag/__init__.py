"""Reads and writes ROS bags without ROS.

:mod:`.types` has the definitions of all messages; :mod:`.recorded_streams` is the topic that
allows a bag exported from a recording to be converted back without loss.
"""
