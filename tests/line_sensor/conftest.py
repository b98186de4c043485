"""Settings of line sensors, and virtual boards."""

from __future__ import annotations

from typing import Any

from biosensor_gateway.devices.line_sensor.driver.settings import LineSettings


def line_settings(**fields: Any) -> LineSettings:
    """Settings of one that listens to UDP, unless the fields say otherwise."""
    way = {} if fields.keys() & {"port", "url"} else {"udp_port": 5005}
    named = {"sensor": "line_sensor", "unit": "1", "columns": ["x", "y"], **way}
    return LineSettings.model_validate(named | fields)
