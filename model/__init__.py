"""The public Python API of ArtiWorld; ``__init__.pyi`` lists its names.

Lengths are metres, angles radians, +z is up, frames are right-handed. Every name is stable: before
one changes, its old form warns for a release. Names load when they are first used, so that
``import model`` costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
