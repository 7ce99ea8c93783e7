"""Where the actuator is in a video that nobody has labelled, from probe frames taken together. Imports no torch."""
