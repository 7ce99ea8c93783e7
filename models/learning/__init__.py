"""How networks learn: from a study's labelled frames, and before that from rendered actuators."""
