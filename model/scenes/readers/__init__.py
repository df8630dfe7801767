"""One file a scene format; :mod:`model.scenes.registry` lists them."""
