"""Collision shapes: few convex bodies a part that leave its hollows open."""
