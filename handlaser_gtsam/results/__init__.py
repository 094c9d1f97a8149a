"""What follows from a calibration: systematic errors that were tested for."""
