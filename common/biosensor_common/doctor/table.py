"""Lists the checks that any computer with LSL can run.

A new one is a module of `biosensor_common.doctor.checks` and a line here.
"""

from __future__ import annotations

from biosensor_common.doctor.check import Category, Check

COMMON_CHECKS = (
    Check("versions", Category.PROGRAM, "versions and places of the programs involved"),
    Check("lsl_config", Category.LSL, "the lsl_api.cfg in force and what it says"),
    Check("discovery", Category.LSL, "a stream of this computer is found here", limit_s=14.0),
    Check("streams", Category.LSL, "all streams in the network", limit_s=15.0),
    Check("interfaces", Category.NETWORK, "network adapters and the way of multicast"),
    Check("ports", Category.NETWORK, "the ports of LSL"),
    Check("linux_firewall", Category.NETWORK, "ufw and firewalld"),
    Check("host_name", Category.NETWORK, "the name of this computer"),
    Check("open_files", Category.COMPUTER, "how many files, and so streams, a program may open"),
    Check("clock", Category.COMPUTER, "what keeps the clock right"),
)
