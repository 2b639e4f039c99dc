"""Servos one by one: find, set up, save and restore their EEPROM."""
