"""Dynamixel servos, Protocol 2.0: the driver, and what servo tools, doctor and emulator share with it."""
