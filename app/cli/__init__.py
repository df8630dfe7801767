"""One file a subcommand, built from documented dataclasses."""
