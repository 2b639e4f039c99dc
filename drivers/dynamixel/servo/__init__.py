"""The servos themselves: control tables, units, torque, heat, and what a servo of an arm must be."""
