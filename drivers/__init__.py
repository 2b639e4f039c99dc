"""What moves an arm: the seam (`interface`), the clock, and the Dynamixel driver."""
