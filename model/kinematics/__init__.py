"""Contact, penetration, motion sweeps and joint snapping."""
