"""Writing assets that simulators load."""
