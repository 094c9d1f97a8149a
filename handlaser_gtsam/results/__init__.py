"""What follows from an estimate: the calibration, its warnings, systematic errors, verdict."""
