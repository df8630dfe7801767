"""Benchmarks: each file measures for several subcommands of ``artiworld bench``."""
