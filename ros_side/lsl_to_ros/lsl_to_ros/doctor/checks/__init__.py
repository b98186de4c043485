"""The checks of ROS, one module each; `lsl_to_ros.doctor.table` lists them."""
