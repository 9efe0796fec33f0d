"""Where RGB-D frames come from: a simulated camera, a RealSense, recordings, folders; all through one interface."""
