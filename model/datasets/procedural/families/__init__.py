"""One file for each few related families."""
