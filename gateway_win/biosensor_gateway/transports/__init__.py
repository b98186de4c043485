"""Links to devices: they read and write bytes without interpreting them."""
