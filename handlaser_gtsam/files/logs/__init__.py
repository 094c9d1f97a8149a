"""Logs of robot controllers, spreadsheets and bags, read as recordings."""
