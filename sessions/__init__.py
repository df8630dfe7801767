"""What people decide: commands, session state, review, and the store that keeps them."""
