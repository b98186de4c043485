#!/bin/bash
# Runs a command in the workspace. The command takes the place of this shell, so that it
# gets the signals of docker stop.
set -e
source /opt/lsl_to_ros/setup.bash
exec "$@"
