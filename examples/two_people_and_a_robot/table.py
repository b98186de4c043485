from pathlib import Path

import pandas as pd


def stream(name: str) -> pd.DataFrame:
    return pd.read_csv(Path("study_csv") / f"{name}.csv")


people = [
    stream(f"{person}-polar_h10-virtual-ibi").assign(person=person) for person in ("P01", "P02")
]
beats = pd.concat(people).sort_values("lsl_time")
beats = pd.merge_asof(beats, stream("joint_states"), on="lsl_time", direction="nearest")
handovers = stream("robot-event").query("marker == 'handover'")
handovers = handovers[["lsl_time"]].assign(handover=handovers["lsl_time"])
beats = pd.merge_asof(beats, handovers, on="lsl_time")
beats["since_handover_s"] = beats["lsl_time"] - beats["handover"]
print(beats[["lsl_time", "person", "RR", "elbow.position", "since_handover_s"]].to_string())
beats.to_csv("beats.csv", index=False)
