"""Learning joint-level policies from a teacher."""
