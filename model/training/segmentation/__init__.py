"""Training of the two small networks of the default segmenter, on procedural objects alone."""
