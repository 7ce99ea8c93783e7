"""Training the network that ships with bendtrack on rendered actuators, for hours, without labels."""
