"""What the readings of a recording are, found before anything is solved."""
