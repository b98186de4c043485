"""Declarations, header, clocks and errors, shared by the capture agent and the ROS node.

Standard library only, so that a ROS machine needs nothing else to read it; the checks of
`doctor` import LSL and psutil when they run.
"""
