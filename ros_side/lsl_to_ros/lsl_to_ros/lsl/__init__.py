"""Finds and reads streams of the Lab Streaming Layer."""
