"""User-facing code: browser screens, HTTP guard, command line, worker processes."""
