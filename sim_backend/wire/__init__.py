"""Emulated Dynamixel servos on pseudo terminals, moved by the plant.  Must never use the driver's codec."""
