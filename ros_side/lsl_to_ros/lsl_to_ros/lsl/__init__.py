"""Finds streams in the Lab Streaming Layer and reads them."""
