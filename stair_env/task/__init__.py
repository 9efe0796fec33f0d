"""The task of an episode: which stairs, which start, which body, which stair block, reward and end."""
