"""Polar Measurement Data (PMD) service: bytes in, typed records out; no I/O, no clock.

Layouts are as in Polar's published documents and SDK [1]_. All numbers are little-endian.

.. [1] https://github.com/polarofficial/polar-ble-sdk, technical documentation.
"""
