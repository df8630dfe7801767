"""Collision shapes, mass, inertia and friction."""
