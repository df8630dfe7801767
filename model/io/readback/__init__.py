"""Exported files as other software reads them."""
