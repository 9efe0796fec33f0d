"""Parts of the fast depth model: what a unit is like, its noise, its holes, and the compiled loops."""
