"""From an image pair to the network's grids: preprocessing, weights and back ends."""
