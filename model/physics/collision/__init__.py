"""Collision shapes: few convex bodies per part that keep its hollows open."""
