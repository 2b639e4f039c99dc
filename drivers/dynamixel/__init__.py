"""Dynamixel Protocol 2.0 servos; ticks, mA, PWM and IDs never leave this folder."""
