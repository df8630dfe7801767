"""Joint candidates and the predictor from geometry alone."""
