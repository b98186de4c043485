"""A reaction-time task in PsychoPy, whose markers are recorded with the sensors.

Start the agent and a recording (biosensor-gateway page), then this in PsychoPy's Coder.
In PsychoPy's own Python, pylsl is there; elsewhere: pip install psychopy pylsl
"""

import random

import pylsl
from psychopy import core, event, visual

TRIALS = 5

# The source_id says which program sends, so that a recorder goes on after a restart.
info = pylsl.StreamInfo("psychopy/markers", "Markers", 1, 0.0, "string", "psychopy-reaction-time")
markers = pylsl.StreamOutlet(info)

window = visual.Window((800, 600), fullscr=False, checkTiming=False)
text = visual.TextStim(window, text="Press the space bar when you see the circle. Space to begin.")
circle = visual.Circle(window, radius=0.3, fillColor="teal")

# PsychoPy's clock and LSL's may count differently: read both at one moment.
to_lsl = pylsl.local_clock() - core.getTime()


def mark(name: str, when: float) -> None:
    """Send a marker with the time on PsychoPy's clock at which it happened."""
    markers.push_sample([name], when + to_lsl)


text.draw()
window.flip()
event.waitKeys(keyList=["space"])
mark("begin", core.getTime())
for trial in range(1, TRIALS + 1):
    window.flip()
    core.wait(random.uniform(0.5, 1.5))
    event.clearEvents()
    circle.draw()
    # flip() returns when the picture is on its way to the screen.
    shown = window.flip()
    mark(f"circle {trial}", shown if shown else core.getTime())
    # A key pressed since clearEvents() counts, however soon it came.
    keys = event.waitKeys(maxWait=3.0, keyList=["space"], timeStamped=True, clearEvents=False)
    if keys:
        mark(f"key {trial}", keys[0][1])
    else:
        mark(f"no key {trial}", core.getTime())
mark("end", core.getTime())
# LSL sends from a thread of its own; do not end before it has sent the last marker.
core.wait(0.5)
window.close()
core.quit()
