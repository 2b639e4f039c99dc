"""Emulated Dynamixel servos on pseudo terminals, moved by the plant; they never use the driver's codec."""
