"""What every floor of the library agrees on: names of observations, and how far drafts look."""

CONTROL_PERIOD = 0.05
"""Time of one control step [s]."""
DRAFT_HORIZON = 8
"""Control steps that a draft looks ahead."""
MEASURED, COMMANDED = DRAFTS = ("measured", "commanded")
"""Which fingertips of a recording a draft leads to: where they were one step later, or were told to be."""
STATE, TACTILE = "observation.state", "observation.tactile"
FINGERTIPS, GRAVITY = "observation.fingertips", "observation.gravity"
LEROBOT_KEYS = {"agent_pos": STATE, "tactile": TACTILE, "fingertips": FINGERTIPS, "gravity": GRAVITY}
"""How LeRobot, and with it every interface, calls what an environment observes beside images."""
