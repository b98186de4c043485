"""One module for each reader: ``check(data)`` says what must hold for any bytes."""
