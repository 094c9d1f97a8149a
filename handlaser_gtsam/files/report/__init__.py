"""The report of a calibration: one page that opens without network, and the same as pictures."""
