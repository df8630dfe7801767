"""Readers of scene formats; :mod:`model.scenes.registry` lists them."""
