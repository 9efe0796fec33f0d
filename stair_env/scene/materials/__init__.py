"""What surfaces are made of: textures, their painters, and wear."""
