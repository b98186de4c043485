"""Finds what is wrong on this ROS computer, and says how to mend it.

The checks that any computer with LSL can run are in `biosensor_common.doctor`; those of
ROS are in `checks`. `table` lists both. ``ros2 doctor`` shows what they find
(`lsl_to_ros.doctor.ros2_doctor`), and so does ``python3 -m lsl_to_ros.doctor``, which needs no
ros2doctor.
"""
