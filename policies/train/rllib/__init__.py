"""Training with RLlib on a Ray cluster; what comes out is a policy like any other (`docs/scaling.md`)."""
