"""A climbing robot to watch and to interfere with, in a browser page (`stair-env[watch]`)."""
