"""Polar Measurement Data (PMD) service: bytes in, typed records out; no I/O, no clock.

Layouts are those of Polar's published documents and SDK [1]_. Every number on the
wire is little-endian.

.. [1] https://github.com/polarofficial/polar-ble-sdk, technical documentation.
"""
