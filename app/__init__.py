"""What people see: the browser screens, the HTTP guard, the command line, the worker processes."""
