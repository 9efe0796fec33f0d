"""Parts for policies without a gait: a command to follow, a height scan to see by, rewards that make legs walk."""
