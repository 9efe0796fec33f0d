"""Things in a scene besides the stairs and the room: their solids, sizes and looks."""
