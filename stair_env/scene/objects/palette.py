"""The looks that distractors choose from, by number."""

from __future__ import annotations

PALETTE = (  # materials of a random scene's palette; the first eight are as old as the first scenes
    "painted", "wood", "painted", "wood", "metal", "concrete", "carpet", "carpet",
    "siding", "panelling", "grating", "grass", "carpet", "painted", "rubber", "painted", "slab_tile", "stone",
)  # fmt: skip
SOLID_LOOKS, MAT_LOOKS = (0, 6), (6, 8)  # half-open ranges
SIDING, PANELLING, GRATING, FOLIAGE, CLOTH, VIVID, RUBBER, SKIN, TILES, STONE = range(8, 18)
