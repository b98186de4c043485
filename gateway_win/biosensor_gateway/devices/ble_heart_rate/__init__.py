"""Any strap that offers the Bluetooth Heart Rate Service."""
