"""Settings that name the server of virtual wristbands: a search finds them there."""

LOCATED = """
# Where the server of the wristbands is.
[[device]]
sensor = "empatica_e4"
unit = "SERVER"
device = "ffffff"
host = "{host}"
port = {port}
enabled = false
"""
