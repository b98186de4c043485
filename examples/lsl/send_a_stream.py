"""Send a stream of your own, which recorders, the page and the ROS node take as any other.

In one terminal: python3 send_a_stream.py
In another:      biosensor-gateway page --lsl
On the robot:    ros2 topic echo /biosensors/my_lab/temperature
Needs: pip install pylsl
"""

import math
import time

import pylsl

# A source_id that stays the same lets receivers go on after a restart of this program.
info = pylsl.StreamInfo(
    "my_lab/temperature", "Temperature", 1, 10.0, "float32", "my-lab-thermometer-1"
)
channel = info.desc().append_child("channels").append_child("channel")
channel.append_child_value("label", "skin")
channel.append_child_value("unit", "celsius")
outlet = pylsl.StreamOutlet(info)

start, count = pylsl.local_clock(), 0
while True:
    # Stamp with the time of the measurement, not with that of sending it.
    measured = start + count / 10.0
    outlet.push_sample([33.0 + math.sin(measured)], measured)
    count += 1
    time.sleep(max(0.0, start + count / 10.0 - pylsl.local_clock()))
