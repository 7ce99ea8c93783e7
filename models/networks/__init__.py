"""The networks, their initial weights and their checkpoints."""
