"""The robot: LEAP hand on xArm7, its numbers, model, kinematics, touch and objects."""
