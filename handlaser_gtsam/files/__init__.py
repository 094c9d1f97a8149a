"""Every file format that goes in or out."""
