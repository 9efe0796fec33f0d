"""Training of StairNetV2: losses, metrics, schedules."""
