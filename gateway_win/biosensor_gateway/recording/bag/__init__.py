"""Reads and writes ROS bags without ROS.

:mod:`.types` has the definitions of all messages; :mod:`.headers` also reads the topic
that allows a bag exported from a recording to be converted back without loss.
"""
