"""A cell file made from what is wanted: arms, object, grasps and a motion."""
