"""Tables 2, 3 and 6 of the paper: the opponents and ablations, trained and scored alike."""
