"""The `stair-env` command line."""
