"""Every format that is read or written, and the saved asset."""
