"""Training of the small models of the default segmenter, on procedural objects only."""
