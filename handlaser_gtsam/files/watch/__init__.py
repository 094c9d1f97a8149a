"""A page that follows a recording as it grows: who reads it, who calibrates, who serves the page."""
