"""The browser screens, one file per panel."""
