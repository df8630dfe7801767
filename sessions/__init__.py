"""Decisions of people: commands, session state, review, and the store that keeps them."""
