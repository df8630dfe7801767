"""Networks published by others, as segmenters.

How to write another adapter: see :mod:`model.segmentation.adapters.example`.
"""
