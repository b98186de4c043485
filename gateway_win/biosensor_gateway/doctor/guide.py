"""The agent's name and its remedies, for checks that both programs share."""

from __future__ import annotations

import sys

from biosensor_common.doctor.guide import Guide

_PIP = f"{sys.executable} -m pip install --force-reinstall"

GUIDE = Guide(
    program="the agent",
    package="biosensor_gateway",
    distribution="biosensor-gateway",
    install=f"in the folder of the project: {sys.executable} -m pip install .",
    install_pylsl=f"{_PIP} pylsl",
    libraries={name: f"{_PIP} {name}" for name in ("bleak", "numpy")},
    ask_itself="biosensor-gateway config lsl",
    ask_others="where LabRecorder is: biosensor-gateway config lsl --for two-pc --peer {peer}",
    correct_file="biosensor-gateway config lsl --force",
    edit="biosensor-gateway config edit",
    alone=(
        "run it alone: biosensor-gateway doctor --only {check}; if it fails again, report it with "
        "the output of: biosensor-gateway doctor --json"
    ),
)
