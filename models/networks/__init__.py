"""The networks themselves, their weights and their checkpoints."""
