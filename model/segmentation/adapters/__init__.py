"""Networks that others published, as segmenters.

How to write another one: see :mod:`model.segmentation.adapters.example`.
"""
