"""The servos themselves: control tables, units, torque and heat."""
