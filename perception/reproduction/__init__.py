"""The tables of the paper, each made again by a module of its own."""
