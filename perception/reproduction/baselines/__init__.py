"""The paper's opponents (table 6): image pair in, stair lines out, scored as the network is."""
