"""Tools around an arm: set up its servos, look after their EEPROM, find out what is wrong.  They never give torque."""
