"""The saved asset: written, read back, loaded by other software."""
