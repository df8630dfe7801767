"""Score described masks with the trained networks and trees, less rule-based penalties."""
