"""Worker processes behind `stair_env.vector`."""
