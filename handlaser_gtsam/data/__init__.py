"""What goes in, checked and frozen: recordings, noise, parameters; what a column really holds."""
