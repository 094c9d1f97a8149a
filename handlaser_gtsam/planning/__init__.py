"""Where to go next: stations that determine a calibration, chosen before they are measured."""
