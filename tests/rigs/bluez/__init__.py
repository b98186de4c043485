"""A BlueZ without a kernel or a radio: org.bluez on a bus of its own, over a virtual radio.

bleak's own Linux backend, unchanged and in any process that has `FakeBluez.environment`,
talks to it, with the error names and the quirks of the real one.
"""

from tests.rigs.bluez.adapter import FakeBluez

__all__ = ["FakeBluez"]
