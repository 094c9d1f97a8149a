"""What follows from a calibration: its verdict, and the systematic errors that it was tested for."""
