"""Propose masks for a click: nested regions, boxes, rectangles on flat fronts."""
