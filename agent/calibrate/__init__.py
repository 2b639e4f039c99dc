"""Calibration of a cell from joint angles alone: base poses, grasps and joint zeros of arms that hold one object."""
