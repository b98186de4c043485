"""One module a sensor, each with one table: ``SENSOR``."""
