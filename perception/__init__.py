"""StairNetV2 and the geometry that turns its lines into steps."""
