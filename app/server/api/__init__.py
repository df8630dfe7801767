"""The REST API: everything that the screens decide, for scripts."""
