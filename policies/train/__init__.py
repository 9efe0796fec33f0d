"""Training of policies: checkpoints, curves and model cards."""
