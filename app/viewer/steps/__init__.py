"""The steps of the work, one module each: annotate, joints, review, and the scene around them."""
